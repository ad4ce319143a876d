/* What a plant supplies, and what the FMI wrapper makes of it.
 *
 * `variables.h` is generated from the plant's plant.toml. It declares `Plant`: every variable as a named field and, the same memory,
 * as `value[reference]`, in the order time, parameters, inputs, states, derivatives, other outputs. All numbers are doubles in SI units.
 */
#ifndef PLANT_H
#define PLANT_H

#include "variables.h"

typedef enum { PLANT_OK, PLANT_WARNING, PLANT_DISCARD, PLANT_ERROR, PLANT_FATAL, PLANT_TERMINATE } PlantStatus;

#if PLANT_HAS_EVENTS
/* The first instant later than `p->time` (by more than rounding) at which an output jumps by itself; INFINITY if there is none.
 * While `p->before` is 1 the outputs are those just before what happens at `p->time`. */
double plant_next_event(const Plant *p);
#endif

/* Fill in the derivatives of the states from time, parameters, inputs and states. */
void plant_derivatives(Plant *p);

/* Fill in the outputs that are not states; the derivatives are filled in already. */
void plant_outputs(Plant *p);

#if PLANT_HAS_TANGENT
/* The linearisation at `p` along `d`: `d` holds small changes of parameters, inputs and states,
 * and receives the changes of derivatives and outputs that follow, to first order and exactly as the formulas say. */
void plant_tangent(const Plant *p, Plant *d);
#endif

#if PLANT_HAS_STEP_HOOK
/* Called before each co-simulation step of `step` seconds, and after each completed integrator step of model exchange (`step` is then 0);
 * a status other than PLANT_OK becomes the step's. */
PlantStatus plant_before_step(Plant *p, double step, const char **message);
#endif

#endif

/* Advances a plant over one co-simulation step. */
#ifndef INTEGRATOR_H
#define INTEGRATOR_H

#include "plant.h"

/* An input over a step is u + u' s + u'' s²/2 + … up to the given order, s the time since the step began. */
typedef struct {
    double order[PLANT_INPUT_DERIVATIVES][PLANT_INPUTS + !PLANT_INPUTS]; /* order[0] is the first derivative; C has no empty arrays */
} InputDerivatives;

/* Who sets the inputs at a time within a step, if anybody does; else they are polynomials. */
typedef struct {
    void (*ask)(void *owner, double time);
    void *owner;
} InputSource;

/* The inputs at `since` seconds after the step began; `start` holds their values at its beginning. */
void inputs_at(Plant *p, const double start[], const InputDerivatives *derivatives, double since);

/* Move time, inputs and states of `p` on by `step` > 0 seconds. Returns 0, or 1 when no finite, converged solution was found
 * (`p` is then unchanged). */
int integrate(Plant *p, const InputDerivatives *derivatives, const InputSource *source, double step);

#endif

/* From FAULT_TIME on, position_2 is not a number, while every call returns OK. */
#define plant_outputs healthy_outputs
#include "two_mass.c"
#undef plant_outputs

#include <math.h>

#define FAULT_TIME 1.0

void plant_outputs(Plant *p) {
    healthy_outputs(p);
    if (p->time >= FAULT_TIME)
        p->position_2 = p->spring = NAN;
}

PlantStatus plant_before_step(Plant *p, double step, const char **message) {
    (void)p, (void)step, (void)message;
    return PLANT_OK;
}

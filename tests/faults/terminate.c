/* From FAULT_TIME on, each step asks for the end of the simulation. */
#include "fault.h"

PlantStatus plant_before_step(Plant *p, double step, const char **message) {
    (void)step;
    if (p->time < FAULT_TIME)
        return PLANT_OK;
    *message = "this is the terminate that was asked for";
    return PLANT_TERMINATE;
}

/* From FAULT_TIME on, each step returns the status warning. */
#include "fault.h"

PlantStatus plant_before_step(Plant *p, double step, const char **message) {
    (void)step;
    if (p->time < FAULT_TIME)
        return PLANT_OK;
    *message = "this is the warning that was asked for";
    return PLANT_WARNING;
}

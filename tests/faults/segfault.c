/* From FAULT_TIME on, a step reads and writes where it must not. */
#include "fault.h"

PlantStatus plant_before_step(Plant *p, double step, const char **message) {
    (void)step, (void)message;
    volatile int *volatile nowhere = 0;
    if (p->time >= FAULT_TIME)
        *nowhere = 1;
    return PLANT_OK;
}

/* From FAULT_TIME on, a step never returns. */
#include "fault.h"

PlantStatus plant_before_step(Plant *p, double step, const char **message) {
    (void)step, (void)message;
    volatile int forever = p->time >= FAULT_TIME;
    while (forever) {
    }
    return PLANT_OK;
}

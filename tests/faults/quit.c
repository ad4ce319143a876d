/* From FAULT_TIME on, a step ends the process as if all were well. */
#include "fault.h"

#include <stdlib.h>

PlantStatus plant_before_step(Plant *p, double step, const char **message) {
    (void)step, (void)message;
    if (p->time >= FAULT_TIME)
        exit(0);
    return PLANT_OK;
}

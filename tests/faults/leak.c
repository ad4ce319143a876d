/* From FAULT_TIME on, each step takes 16 MiB that it never gives back, and does not look whether it got them. */
#include "fault.h"

#include <stdlib.h>
#include <string.h>

#define PORTION ((size_t)16 << 20)

PlantStatus plant_before_step(Plant *p, double step, const char **message) {
    (void)step, (void)message;
    for (int i = 0; p->time >= FAULT_TIME && i < 8; i++) {
        char *volatile kept = malloc(PORTION);
        memset(kept, 1, PORTION);
    }
    return PLANT_OK;
}

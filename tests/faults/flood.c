/* Healthy, but each step writes LINES lines to standard output and standard error. */
#include "fault.h"

#include <stdio.h>

#define LINES 1000

PlantStatus plant_before_step(Plant *p, double step, const char **message) {
    (void)step, (void)message;
    for (int i = 0; i < LINES; i++) {
        printf("standard output at %.6f s: line %d of a flood of lines that nobody asked for\n", p->time, i);
        fprintf(stderr, "standard error at %.6f s: line %d of a flood of lines that nobody asked for\n", p->time, i);
    }
    fflush(stdout);
    return PLANT_OK;
}

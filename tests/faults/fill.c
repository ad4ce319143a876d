/* From FAULT_TIME on, each step writes to a file in the working directory for as long as it can. */
#include "fault.h"

#include <errno.h>
#include <stdio.h>
#include <string.h>

PlantStatus plant_before_step(Plant *p, double step, const char **message) {
    (void)step;
    static char portion[1 << 16];
    if (p->time < FAULT_TIME)
        return PLANT_OK;
    FILE *file = fopen("big", "ab");
    while (file && fwrite(portion, sizeof portion, 1, file) == 1) {
    }
    *message = strerror(errno);
    if (file)
        fclose(file);
    return PLANT_ERROR;
}

/* What a shaper remembers: the reference of the last `DURATION` seconds, and the states of its filters. Plain data, of fixed size. */
#ifndef SHAPER_H
#define SHAPER_H

#include "constants.h"

/* From `time` [s] to the next piece the reference was `value + slope (t - time)`, in deviations from its value at rest. */
typedef struct {
    double time, value, slope;
} Piece;

typedef struct {
    double real, imaginary;
} Complex;

typedef struct {
    int first, count;             /* in the ring `pieces` */
    double reached;               /* the reference at the end of the last piece, in deviations */
    double filtered;              /* up to when [s] the filters have been run */
    Complex states[FILTER_STATES + !FILTER_STATES];
    Piece pieces[HISTORY];
} Memory;

#endif

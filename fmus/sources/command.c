/* A command as a block without inputs: segments (level and slope), then a tail of decaying terms. The numbers stand in constants.h.
 *
 * It is a function of time and remembers nothing, so its output is exact at any communication point, and right-continuous: at a switch it is
 * the value after it. In event mode it is the value before, until the event has been handled.
 */
#include "plant.h"
#include "integrator.h"

#include "constants.h"

#include <math.h>

/* Instants nearer than this are one: an importer computes the instant of a switch in its own way, and rounding must not hide the switch
 * from it for a whole step. */
static double rounding(const Plant *p) { return 1e-12 * fmax(fabs(p->time), END); }

static double start_of(int i) { return i < SEGMENTS ? SEGMENT[i].start : END; }

/* How many of the segments' starts, the tail's included, lie at or before `at` [s]. */
static int begun(double at) {
    int low = 0, high = SEGMENTS + 1;
    while (low < high) {
        const int middle = low + (high - low) / 2;
        if (start_of(middle) <= at)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

static double tail(double since) {
    double sum = STEADY;
    for (int i = 0; i < TERMS; i++) {
        const double angle = TERM[i].frequency * since;
        const double wave = TERM[i].real * cos(angle) - TERM[i].imaginary * sin(angle);
        sum += wave * pow(since, TERM[i].power) * exp(TERM[i].rate * since);
    }
    return sum;
}

double plant_next_event(const Plant *p) {
    const int next = begun(p->time - p->delay + rounding(p));
    return next <= SEGMENTS ? p->delay + start_of(next) : INFINITY;
}

void plant_outputs(Plant *p) {
    const double at = p->time - p->delay;
    const int current = begun(at + (p->before ? -rounding(p) : rounding(p))) - 1;
    double u = p->rest;
    if (current == SEGMENTS)
        u = tail(fmax(at - END, 0.0));
    else if (current >= 0)
        u = SEGMENT[current].level + SEGMENT[current].slope * fmax(at - SEGMENT[current].start, 0.0);
    /* Not rest + scale (u - rest): with a scale of 1 the command's own bits come out. */
    p->value[PLANT_FIRST_OUTPUT] = p->scale * u + (1.0 - p->scale) * p->rest;
}

void plant_derivatives(Plant *p) { (void)p; }

int integrate(Plant *p, const InputDerivatives *derivatives, const InputSource *source, double step) {
    (void)derivatives, (void)source;
    p->time += step;
    return 0;
}

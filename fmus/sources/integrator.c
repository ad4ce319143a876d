/* Gragg-Bulirsch-Stoer extrapolation (Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, II.9).
 *
 * The smoothed midpoint rule with 2, 4, 6 … substeps has an error series in even powers of the substep; polynomial extrapolation to zero
 * removes one power a column. The order adapts itself to the step, so there is no coefficient table, and nothing is remembered
 * between calls: the same state, input and step always give the same bits.
 */
#include "integrator.h"

#include <math.h>
#include <string.h>

#define COLUMNS 8          /* up to order 16 */
#define TOLERANCE 1e-13    /* of a state's size: what one column may differ from the next */
#define SMALLEST 1e-9      /* of the communication step */

/* FINE: the columns agree to the tolerance, relative to the state itself. COARSE: relative to its nominal value only, which is all that
 * rounding leaves of a small state beside large ones (the velocity of a machine at rest far from the origin). */
typedef enum { NOT_CONVERGED, COARSE, FINE } Quality;

typedef struct {
    Plant *plant;
    const double *inputs;
    const InputDerivatives *derivatives;
    const InputSource *source;
    double time; /* at the beginning of the communication step */
} Problem;

void inputs_at(Plant *p, const double start[], const InputDerivatives *derivatives, double since) {
    for (int i = 0; i < PLANT_INPUTS; i++) {
        double sum = 0.0;
        for (int order = PLANT_INPUT_DERIVATIVES; order >= 1; order--)
            sum = (sum + derivatives->order[order - 1][i]) * since / order;
        p->value[PLANT_FIRST_INPUT + i] = start[i] + sum;
    }
}

static void set_inputs(const Problem *q, double since) {
    q->plant->time = q->time + since;
    if (q->source->ask)
        q->source->ask(q->source->owner, q->plant->time);
    else
        inputs_at(q->plant, q->inputs, q->derivatives, since);
}

static const double *slope(const Problem *q, double since, const double x[PLANT_STATES], const double increment[PLANT_STATES]) {
    Plant *p = q->plant;
    set_inputs(q, since);
    for (int i = 0; i < PLANT_STATES; i++)
        p->value[PLANT_FIRST_STATE + i] = x[i] + increment[i];
    plant_derivatives(p);
    return p->value + PLANT_FIRST_DERIVATIVE;
}

/* The increment of `x` over [since, since + width] by the smoothed midpoint rule with `count` (even) substeps.
 * Increments, not states, are summed: rounding then scales with the motion and not with the position. */
static void midpoint(const Problem *q, double since, double width, int count, const double x[PLANT_STATES],
                     const double first[PLANT_STATES], double result[PLANT_STATES]) {
    const double h = width / count;
    double before[PLANT_STATES] = {0.0}, now[PLANT_STATES];
    for (int i = 0; i < PLANT_STATES; i++)
        now[i] = h * first[i];
    for (int k = 1; k < count; k++) {
        const double *f = slope(q, since + k * h, x, now);
        for (int i = 0; i < PLANT_STATES; i++) {
            const double next = before[i] + 2.0 * h * f[i];
            before[i] = now[i];
            now[i] = next;
        }
    }
    const double *f = slope(q, since + width, x, now);
    for (int i = 0; i < PLANT_STATES; i++)
        result[i] = 0.5 * (before[i] + now[i] + h * f[i]);
}

static Quality agreement(const double x[PLANT_STATES], const double increment[PLANT_STATES], const double earlier[PLANT_STATES]) {
    Quality quality = FINE;
    for (int i = 0; i < PLANT_STATES; i++) {
        const double difference = fabs(increment[i] - earlier[i]);
        const double size = fmax(fabs(x[i]), fabs(x[i] + increment[i]));
        /* Written so that NaN counts as not converged. */
        if (!(difference <= TOLERANCE * fmax(size, PLANT_NOMINAL[i])))
            return NOT_CONVERGED;
        if (difference > TOLERANCE * size)
            quality = COARSE;
    }
    return quality;
}

/* The increment of `x` over [since, since + width], with as many columns as it takes. */
static Quality extrapolate(const Problem *q, double since, double width, const double x[PLANT_STATES], double increment[PLANT_STATES],
                           int *columns) {
    static const double zero[PLANT_STATES] = {0.0};
    double first[PLANT_STATES], earlier[PLANT_STATES], table[COLUMNS][PLANT_STATES];
    Quality quality = NOT_CONVERGED;
    memcpy(first, slope(q, since, x, zero), sizeof first);
    for (int k = 0; k < COLUMNS; k++) {
        midpoint(q, since, width, 2 * (k + 1), x, first, increment);
        for (int i = 0; i < PLANT_STATES; i++) {
            double entry = increment[i];
            for (int j = 1; j <= k; j++) { /* table[j - 1] holds column j - 1 of the row before */
                const double ratio = (double)(k + 1) / (k + 1 - j);
                const double refined = entry + (entry - table[j - 1][i]) / (ratio * ratio - 1.0);
                table[j - 1][i] = earlier[i] = entry;
                entry = refined;
            }
            table[k][i] = increment[i] = entry;
        }
        if (k < 2)
            continue;
        /* One column more than the test asks for: it costs little and gains two orders. */
        const int enough = quality == FINE;
        quality = agreement(x, increment, earlier);
        *columns = k + 1;
        if (quality == FINE && enough)
            break;
    }
    return quality;
}

int integrate(Plant *p, const InputDerivatives *derivatives, const InputSource *source, double step) {
    const Plant before = *p;
    const Problem q = {p, before.value + PLANT_FIRST_INPUT, derivatives, source, before.time};
    double x[PLANT_STATES], increment[PLANT_STATES], since = 0.0, width = step, halved = 0.0;
    memcpy(x, before.value + PLANT_FIRST_STATE, sizeof x);
    while (since < step) {
        const int last = width >= (step - since) * (1.0 - 1e-12);
        const double h = last ? step - since : width;
        int columns = 0;
        const Quality quality = extrapolate(&q, since, h, x, increment, &columns);
        /* A truncation error vanishes when the width is halved, rounding does not: so half of a coarse width is accepted in any case. */
        if (quality == NOT_CONVERGED || (quality == COARSE && h > halved)) {
            width = 0.5 * h;
            if (quality == COARSE)
                halved = width * (1.0 + 1e-12);
            if (width < SMALLEST * step) {
                *p = before;
                return 1;
            }
            continue;
        }
        for (int i = 0; i < PLANT_STATES; i++)
            x[i] += increment[i];
        since = last ? step : since + h;
        width = columns < COLUMNS - 2 ? 2.0 * h : h;
    }
    set_inputs(&q, step);
    memcpy(p->value + PLANT_FIRST_STATE, x, sizeof x);
    return 0;
}

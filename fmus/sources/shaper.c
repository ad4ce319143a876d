/* A shaper as a block: shaped = reference * (impulses + decaying terms, or pulses), in real time. The numbers stand in constants.h.
 *
 * All of it is linear, so it works in deviations of the reference from its value at rest, which it had for all time before the start. At rest
 * the output is GAIN times the reference: 1 of a shaper; a filter that cancels poles and zeros makes an input of a reference.
 *
 * The reference is known at communication points only. Between them it is read as held (the value given for a step lasts until its end; in
 * FMI 2.0 its first derivative is honoured) or, with `linear`, as a straight line that begins where the last step ended and reaches the given
 * value at the end of the step. Either reading is made of linear pieces, and for those the output is exact.
 *
 * At a jump there are two outputs. What an importer reads after a step is the output just before the communication point, for it has not given
 * the input at that point yet, and an output in which old jumps are seen but the newest is not would be shaped wrongly. Given the input (or
 * after the event has been handled, in event mode) it is the output just after.
 */
#include "plant.h"
#include "integrator.h"

#include <math.h>
#include <stddef.h>

#define TEXT_OF(number) #number
#define TEXT(macro) TEXT_OF(macro)

/* Instants nearer than this are one: a communication point and the sum of an earlier one and an impulse's time differ by rounding. */
static double rounding(double time) { return 1e-12 * fmax(fabs(time), DURATION); }

/* Unsigned, so that no number, from wherever a state was read, leads out of the ring. */
static unsigned place(const Memory *m, int i) { return ((unsigned)m->first + (unsigned)i) % HISTORY; }

static const Piece *piece(const Memory *m, int i) { return &m->pieces[place(m, i)]; }

static double input(const Plant *p) { return p->value[PLANT_FIRST_INPUT] - p->rest; }

/* How many of the pieces begin at or before `at` [s]. */
static int begun(const Memory *m, double at) {
    int low = 0, high = m->count;
    while (low < high) {
        const int middle = low + (high - low) / 2;
        if (piece(m, middle)->time <= at)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

/* The reference at `at` [s], on the side of a jump that is asked for. */
static double reference(const Plant *p, double at) {
    const double tolerance = rounding(p->time);
    if (!p->before && !p->linear && at >= p->time - tolerance)
        return input(p);
    const int count = begun(&p->memory, p->before ? at - tolerance : at + tolerance);
    if (count == 0)
        return 0.0;
    const Piece *last = piece(&p->memory, count - 1);
    return last->value + last->slope * fmax(at - last->time, 0.0);
}

/* The integral of the reference from `start` to `stop` [s], not later than now: exact, for it is made of linear pieces. */
static double area(const Memory *m, double start, double stop) {
    const int first = begun(m, start);
    double sum = 0.0;
    for (int i = first > 0 ? first - 1 : 0; i < m->count && piece(m, i)->time < stop; i++) {
        const Piece *now = piece(m, i);
        const double from = fmax(now->time, start);
        const double until = i + 1 < m->count ? fmin(piece(m, i + 1)->time, stop) : stop;
        sum += (until - from) * (now->value + now->slope * (0.5 * (from + until) - now->time));
    }
    return sum;
}

static Complex times(Complex a, Complex b) {
    const Complex product = {a.real * b.real - a.imaginary * b.imaginary, a.real * b.imaginary + a.imaginary * b.real};
    return product;
}

static void add(Complex *sum, double factor, Complex term) {
    sum->real += factor * term.real;
    sum->imaginary += factor * term.imaginary;
}

/* integral[j] = ∫_0^width τ^j e^{pτ} dτ for j = 0 … count. */
static void integrals(Complex p, double width, Complex end, int count, Complex integral[]) {
    const Complex z = {p.real * width, p.imaginary * width};
    const double size = z.real * z.real + z.imaginary * z.imaginary;
    const double norm = p.real * p.real + p.imaginary * p.imaginary;
    const Complex inverse = {p.real / norm, -p.imaginary / norm};
    double power = width; /* width^(j+1) */
    for (int j = 0; j <= count; j++, power *= width) {
        Complex sum = {0.0, 0.0};
        if (size < 16.0) {
            /* width^(j+1) e^z Σ (-z)^m j!/(j+1+m)!: nothing cancels, however small z is */
            Complex term = {1.0 / (j + 1), 0.0};
            for (int m = 0; m < 100 && fabs(term.real) + fabs(term.imaginary) > 1e-18; m++) {
                const Complex factor = {-z.real / (j + 2 + m), -z.imaginary / (j + 2 + m)};
                add(&sum, power, term);
                term = times(term, factor);
            }
            sum = times(sum, end);
        } else {
            /* by parts: (width^j e^z - j integral[j-1]) / p, for j = 0 (e^z - 1) / p */
            add(&sum, power / width, end);
            if (j == 0)
                sum.real -= 1.0;
            else
                add(&sum, -j, integral[j - 1]);
            sum = times(sum, inverse);
        }
        integral[j] = sum;
    }
}

/* The states x_j = ∫ r(t - τ) τ^j e^{pτ} dτ of one filter, `width` seconds on, the reference being `value + slope σ` in them. */
static void run(const Filter *filter, Complex x[], double width, double value, double slope) {
    const Complex p = {filter->rate, filter->frequency};
    const double decay = exp(p.real * width);
    const Complex end = {decay * cos(p.imaginary * width), decay * sin(p.imaginary * width)};
    Complex integral[FILTER_POWERS + 1];
    integrals(p, width, end, filter->count, integral);
    for (int j = filter->count - 1; j >= 0; j--) { /* downwards: x_j needs the old x_i below it */
        Complex sum = {0.0, 0.0};
        double weight = 1.0; /* j over i, times width^(j-i) */
        for (int i = j; i >= 0; i--) {
            add(&sum, weight, x[i]);
            weight *= width * i / (j - i + 1);
        }
        sum = times(sum, end);
        add(&sum, value + slope * width, integral[j]);
        add(&sum, -slope, integral[j + 1]);
        x[j] = sum;
    }
}

static void filter_until(Memory *m, double time) {
    for (int f = 0; f < FILTERS; f++) {
        Complex *x = m->states + FILTER[f].first;
        double at = m->filtered - FILTER[f].start;
        const double end = time - FILTER[f].start;
        for (int i = begun(m, at) - 1; i < m->count; i++) {
            const double until = i + 1 < m->count ? fmin(piece(m, i + 1)->time, end) : end;
            if (until <= at)
                continue;
            if (i >= 0) /* before the first piece the reference rests, and so do the states */
                run(&FILTER[f], x, until - at, piece(m, i)->value + piece(m, i)->slope * (at - piece(m, i)->time), piece(m, i)->slope);
            at = until;
        }
    }
    m->filtered = time;
}

void plant_outputs(Plant *p) {
    double sum = 0.0;
    for (int i = 0; i < IMPULSES; i++)
        sum += IMPULSE[i].amplitude * reference(p, p->time - IMPULSE[i].time);
    for (int i = 0; i < PULSES; i++) {
        const double last = p->time - PULSE[i].start;
        sum += PULSE[i].height * area(&p->memory, last - PULSE[i].width, last);
    }
    for (int f = 0; f < FILTERS; f++)
        for (int j = 0; j < FILTER[f].count; j++) {
            const int i = FILTER[f].first + j;
            sum += COEFFICIENT[i].real * p->memory.states[i].real - COEFFICIENT[i].imaginary * p->memory.states[i].imaginary;
        }
    p->value[PLANT_FIRST_OUTPUT] = GAIN * p->rest + sum;
}

/* A jump of the held reference comes out again at every impulse's time. */
double plant_next_event(const Plant *p) {
    const double tolerance = rounding(p->time);
    double next = INFINITY;
    if (p->linear)
        return next;
    for (int i = 0; i < IMPULSES; i++) {
        const int count = begun(&p->memory, p->time - IMPULSE[i].time + tolerance);
        if (count < p->memory.count)
            next = fmin(next, piece(&p->memory, count)->time + IMPULSE[i].time);
        else if (IMPULSE[i].time > tolerance && input(p) != p->memory.reached) /* the jump at this very instant */
            next = fmin(next, p->time + IMPULSE[i].time);
    }
    return next;
}

PlantStatus plant_before_step(Plant *p, double step, const char **message) {
    Memory *m = &p->memory;
    (void)step;
    if (m->count == 0)
        m->filtered = p->time;
    /* What lies further back than the shaper's duration is forgotten. */
    while (m->count > 1 && piece(m, 1)->time <= p->time - DURATION - rounding(p->time)) {
        m->first = (int)place(m, 1);
        m->count--;
    }
    if (m->count < HISTORY)
        return PLANT_OK;
    *message = "the reference has changed more than " TEXT(HISTORY) " times within the " TEXT(DURATION) " s that the shaper remembers: "
               "take longer steps, or make the history longer (constants.h, or slewcert fmus export --history)";
    return PLANT_ERROR;
}

int integrate(Plant *p, const InputDerivatives *derivatives, const InputSource *source, double step) {
    (void)source; /* never set: it takes its input at communication points */
    Memory *m = &p->memory;
    Piece next = {p->time, input(p), derivatives->order[0][0]};
    if (p->linear) {
        next.value = m->reached;
        next.slope = (input(p) - m->reached) / step;
    }
    const Piece *last = m->count ? piece(m, m->count - 1) : NULL;
    /* A reference that stays where it is takes no room. */
    if (!(last && last->slope == 0.0 && next.slope == 0.0 && last->value == next.value)) {
        m->pieces[place(m, m->count)] = next;
        m->count++;
    }
    m->reached = p->linear ? input(p) : next.value + next.slope * step;
    p->time += step;
    if (!p->linear && next.slope != 0.0)
        p->value[PLANT_FIRST_INPUT] = m->reached + p->rest;
    filter_until(m, p->time);
    return 0;
}

void plant_derivatives(Plant *p) { (void)p; }

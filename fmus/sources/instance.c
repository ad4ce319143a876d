#include "instance.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

PlantStatus report(const Instance *c, PlantStatus status, const char *format, ...) {
    char message[512];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(message, sizeof message, format, arguments);
    va_end(arguments);
    c->logger(c, status, message);
    return status;
}

static int is_parameter(unsigned r) { return r >= PLANT_FIRST_PARAMETER && r < PLANT_FIRST_PARAMETER + PLANT_PARAMETERS; }
static int is_input(unsigned r) { return r >= PLANT_FIRST_INPUT && r < PLANT_FIRST_INPUT + PLANT_INPUTS; }
static int is_state(unsigned r) { return r >= PLANT_FIRST_STATE && r < PLANT_FIRST_STATE + PLANT_STATES; }

Instance *create(const char *name, int model_exchange, void *environment, void (*log)(void), Logger *logger) {
    Instance *c = calloc(1, sizeof *c);
    if (!c)
        return NULL;
    if (!name)
        name = "";
    c->name = malloc(strlen(name) + 1);
    if (!c->name) {
        free(c);
        return NULL;
    }
    strcpy(c->name, name);
    c->model_exchange = model_exchange;
    c->environment = environment;
    c->log = log;
    c->logger = logger;
    reset(c);
    return c;
}

void destroy(Instance *c) {
    if (c)
        free(c->name);
    free(c);
}

PlantStatus check_token(const Instance *c, const char *token) {
    if (token && strcmp(token, PLANT_TOKEN) == 0)
        return PLANT_OK;
    return report(c, PLANT_ERROR, "this library belongs to the model description %s, not %s", PLANT_TOKEN, token ? token : "(none)");
}

PlantStatus reset(Instance *c) {
    memset(&c->state, 0, sizeof c->state);
    memcpy(c->state.plant.value, PLANT_START, sizeof c->state.plant.value);
    c->state.outdated = 1;
    return PLANT_OK;
}

PlantStatus require(const Instance *c, const char *call, unsigned phases) {
    static const char *const names[] = {"instantiated",         "in initialization mode", "in event mode",
                                        "in continuous-time mode", "in step mode",        "terminated"};
    if (IN(c->state.phase) & phases)
        return PLANT_OK;
    return report(c, PLANT_ERROR, "%s is not allowed while the instance is %s", call, names[c->state.phase]);
}

PlantStatus enter(Instance *c, const char *call, unsigned from, Phase to) {
    PlantStatus status = require(c, call, from);
    if (status == PLANT_OK)
        c->state.phase = to;
    return status;
}

PlantStatus set_experiment(Instance *c, double start, int stop_defined, double stop) {
    if (!isfinite(start) || (stop_defined && !(isfinite(stop) && stop > start)))
        return report(c, PLANT_ERROR, "an experiment from %.17g s to %.17g s is impossible", start, stop);
    c->state.plant.time = start;
    c->state.stop_defined = stop_defined;
    c->state.stop = stop;
#if PLANT_HAS_EVENTS
    c->state.plant.before = PLANT_OUTPUTS_BEFORE;
#endif
    c->state.outdated = 1;
    return PLANT_OK;
}

static void update(Instance *c) {
    if (!c->state.outdated)
        return;
    plant_derivatives(&c->state.plant);
    plant_outputs(&c->state.plant);
    c->state.outdated = 0;
}

static PlantStatus check_reference(const Instance *c, Type type, unsigned r) {
    if (r >= PLANT_VARIABLES)
        return report(c, PLANT_ERROR, "there is no variable with value reference %u", r);
    if ((type == BOOLEAN) != PLANT_BOOLEAN[r])
        return report(c, PLANT_ERROR, "%s is %s", PLANT_NAMES[r], PLANT_BOOLEAN[r] ? "a Boolean" : "no Boolean");
    return PLANT_OK;
}

PlantStatus get_values(Instance *c, Type type, const unsigned references[], size_t count, double values[]) {
    for (size_t i = 0; i < count; i++)
        if (check_reference(c, type, references[i]) != PLANT_OK)
            return PLANT_ERROR;
    update(c);
    for (size_t i = 0; i < count; i++)
        values[i] = c->state.plant.value[references[i]];
    return PLANT_OK;
}

static PlantStatus check_value(const Instance *c, Type type, unsigned r, double value) {
    const unsigned initial = IN(CREATED) | IN(INITIALIZING);
    if (check_reference(c, type, r) != PLANT_OK)
        return PLANT_ERROR;
    if (!is_parameter(r) && !is_input(r) && !is_state(r))
        return report(c, PLANT_ERROR, "%s is calculated and cannot be set", PLANT_NAMES[r]);
    if (!is_input(r) && !(IN(c->state.phase) & initial))
        return report(c, PLANT_ERROR, "%s can be set before the end of the initialization only", PLANT_NAMES[r]);
    if (c->state.phase == TERMINATED)
        return report(c, PLANT_ERROR, "%s cannot be set: the instance is terminated", PLANT_NAMES[r]);
    if (!isfinite(value))
        return report(c, PLANT_ERROR, "%s must be finite, not %g", PLANT_NAMES[r], value);
    if (PLANT_POSITIVE[r] && !(value > 0.0))
        return report(c, PLANT_ERROR, "%s must be positive, not %.17g", PLANT_NAMES[r], value);
    return PLANT_OK;
}

PlantStatus set_values(Instance *c, Type type, const unsigned references[], size_t count, const double values[]) {
    /* All or nothing: a refused call leaves no half of itself behind. */
    for (size_t i = 0; i < count; i++) {
        PlantStatus status = check_value(c, type, references[i], values[i]);
        if (status != PLANT_OK)
            return status;
    }
    for (size_t i = 0; i < count; i++) {
        c->state.plant.value[references[i]] = values[i];
#if PLANT_HAS_EVENTS
        if (is_input(references[i]) && c->state.phase == STEPPING)
            c->state.plant.before = 0; /* the input at this very instant is known now */
#endif
    }
    c->state.outdated = 1;
    return PLANT_OK;
}

PlantStatus set_input_derivative(Instance *c, unsigned reference, int order, double value) {
    if (!is_input(reference))
        return report(c, PLANT_ERROR, "value reference %u is no input, so it takes no derivatives", reference);
    if (order < 1 || order > PLANT_INPUT_DERIVATIVES)
        return report(c, PLANT_ERROR, "derivatives of %s are supported from order 1 to %d, not %d", PLANT_NAMES[reference],
                      PLANT_INPUT_DERIVATIVES, order);
    if (!isfinite(value))
        return report(c, PLANT_ERROR, "a derivative of %s must be finite, not %g", PLANT_NAMES[reference], value);
    c->state.input_derivatives.order[order - 1][reference - PLANT_FIRST_INPUT] = value;
    return PLANT_OK;
}

PlantStatus set_time(Instance *c, double time) {
    if (!isfinite(time))
        return report(c, PLANT_ERROR, "time must be finite, not %g", time);
    c->state.plant.time = time;
    c->state.outdated = 1;
    return PLANT_OK;
}

static PlantStatus check_count(const Instance *c, size_t count) {
    if (count == PLANT_STATES)
        return PLANT_OK;
    return report(c, PLANT_ERROR, "there are %d continuous states, not %zu", PLANT_STATES, count);
}

PlantStatus get_states(Instance *c, double values[], size_t count) {
    if (check_count(c, count) != PLANT_OK)
        return PLANT_ERROR;
    memcpy(values, c->state.plant.value + PLANT_FIRST_STATE, sizeof(double) * PLANT_STATES);
    return PLANT_OK;
}

PlantStatus set_states(Instance *c, const double values[], size_t count) {
    if (check_count(c, count) != PLANT_OK)
        return PLANT_ERROR;
    for (size_t i = 0; i < count; i++)
        if (!isfinite(values[i]))
            return report(c, PLANT_ERROR, "%s must be finite, not %g", PLANT_NAMES[PLANT_FIRST_STATE + i], values[i]);
    memcpy(c->state.plant.value + PLANT_FIRST_STATE, values, sizeof(double) * PLANT_STATES);
    c->state.outdated = 1;
    return PLANT_OK;
}

PlantStatus get_derivatives(Instance *c, double values[], size_t count) {
    if (check_count(c, count) != PLANT_OK)
        return PLANT_ERROR;
    update(c);
    memcpy(values, c->state.plant.value + PLANT_FIRST_DERIVATIVE, sizeof(double) * PLANT_STATES);
    return PLANT_OK;
}

PlantStatus complete_step(Instance *c, const char *call, int *terminate) {
    PlantStatus status = require(c, call, IN(CONTINUOUS));
    *terminate = 0;
#if PLANT_HAS_STEP_HOOK
    if (status == PLANT_OK) {
        const char *message = "";
        status = plant_before_step(&c->state.plant, 0.0, &message);
        if (status != PLANT_OK)
            report(c, status, "%s", message);
        *terminate = status == PLANT_TERMINATE;
    }
#endif
    return *terminate ? PLANT_OK : status;
}

PlantStatus get_nominals(const Instance *c, double values[], size_t count) {
    if (check_count(c, count) != PLANT_OK)
        return PLANT_ERROR;
    memcpy(values, PLANT_NOMINAL, sizeof(double) * PLANT_STATES);
    return PLANT_OK;
}

#if PLANT_HAS_TANGENT
static PlantStatus check_partials(const Instance *c, const unsigned unknowns[], size_t n_unknowns, const unsigned knowns[],
                                  size_t n_knowns) {
    for (size_t i = 0; i < n_knowns; i++)
        if (!is_parameter(knowns[i]) && !is_input(knowns[i]) && !is_state(knowns[i]))
            return report(c, PLANT_ERROR, "value reference %u is no parameter, input or state to differentiate by", knowns[i]);
    for (size_t i = 0; i < n_unknowns; i++)
        if (unknowns[i] < PLANT_FIRST_STATE || unknowns[i] >= PLANT_VARIABLES)
            return report(c, PLANT_ERROR, "value reference %u is no derivative or output to differentiate", unknowns[i]);
    return PLANT_OK;
}
#endif

PlantStatus directional(Instance *c, const unsigned unknowns[], size_t n_unknowns, const unsigned knowns[], size_t n_knowns,
                        const double seed[], double sensitivity[]) {
#if PLANT_HAS_TANGENT
    if (check_partials(c, unknowns, n_unknowns, knowns, n_knowns) != PLANT_OK)
        return PLANT_ERROR;
    update(c);
    Plant change = {.value = {0.0}};
    for (size_t i = 0; i < n_knowns; i++)
        change.value[knowns[i]] += seed[i];
    plant_tangent(&c->state.plant, &change);
    for (size_t i = 0; i < n_unknowns; i++)
        sensitivity[i] = change.value[unknowns[i]];
    return PLANT_OK;
#else
    (void)unknowns, (void)n_unknowns, (void)knowns, (void)n_knowns, (void)seed, (void)sensitivity;
    return report(c, PLANT_ERROR, "this plant provides no directional derivatives");
#endif
}

PlantStatus adjoint(Instance *c, const unsigned unknowns[], size_t n_unknowns, const unsigned knowns[], size_t n_knowns,
                    const double seed[], double sensitivity[]) {
#if PLANT_HAS_TANGENT
    if (check_partials(c, unknowns, n_unknowns, knowns, n_knowns) != PLANT_OK)
        return PLANT_ERROR;
    update(c);
    for (size_t j = 0; j < n_knowns; j++) {
        Plant change = {.value = {0.0}};
        change.value[knowns[j]] = 1.0;
        plant_tangent(&c->state.plant, &change);
        sensitivity[j] = 0.0;
        for (size_t i = 0; i < n_unknowns; i++)
            sensitivity[j] += seed[i] * change.value[unknowns[i]];
    }
    return PLANT_OK;
#else
    (void)unknowns, (void)n_unknowns, (void)knowns, (void)n_knowns, (void)seed, (void)sensitivity;
    return report(c, PLANT_ERROR, "this plant provides no adjoint derivatives");
#endif
}

PlantStatus do_step(Instance *c, double time, double step) {
    State *s = &c->state;
    PlantStatus status = require(c, "doStep", IN(STEPPING));
    if (status != PLANT_OK)
        return status;
    if (!(isfinite(step) && step > 0.0))
        return report(c, PLANT_ERROR, "a communication step must be positive and finite, not %.17g s", step);
    /* The importer may compute t0 + n h in another way than by adding; it may not skip or repeat a part of the motion. */
    if (!(fabs(time - s->plant.time) <= 1e-9 * fmax(step, fabs(time))))
        return report(c, PLANT_ERROR, "the step begins at %.17g s, but the instance is at %.17g s", time, s->plant.time);
    if (s->stop_defined && time + step > s->stop + 1e-9 * fmax(step, fabs(s->stop)))
        return report(c, PLANT_ERROR, "a step to %.17g s leads beyond the stop time of %.17g s", time + step, s->stop);
    s->plant.time = time;
    s->event = 0;
    status = PLANT_OK;
#if PLANT_HAS_EVENTS
    if (c->event_mode) {
        const double next = plant_next_event(&s->plant);
        s->event = next <= time + step * (1.0 + 1e-12);
        if (s->event && c->early_return && next < time + step)
            step = next - time;
    }
#endif
#if PLANT_HAS_STEP_HOOK
    const char *message = "";
    status = plant_before_step(&s->plant, step, &message);
    if (status != PLANT_OK)
        report(c, status, "%s", message);
    if (status == PLANT_DISCARD || status == PLANT_ERROR || status == PLANT_FATAL)
        return status;
#endif
    if (integrate(&s->plant, &s->input_derivatives, &c->source, step) != 0)
        return report(c, PLANT_ERROR, "no finite solution was found from %.17g s to %.17g s", time, time + step);
    memset(&s->input_derivatives, 0, sizeof s->input_derivatives); /* they were given for this step */
#if PLANT_HAS_EVENTS
    s->plant.before = PLANT_OUTPUTS_BEFORE || s->event;
#endif
    s->outdated = 1;
    s->terminate = status == PLANT_TERMINATE;
    return status;
}

PlantStatus update_discrete(Instance *c, const char *call, double *next) {
    *next = INFINITY;
    if (require(c, call, IN(EVENTS)) != PLANT_OK)
        return PLANT_ERROR;
#if PLANT_HAS_EVENTS
    c->state.plant.before = 0;
    c->state.outdated = 1;
    *next = plant_next_event(&c->state.plant);
#endif
    return PLANT_OK;
}

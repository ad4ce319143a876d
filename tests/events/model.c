/* A small FMU with events, for both versions of FMI (-DFMI=2 or 3): what it does is chosen by -DKIND. It shares nothing with the plants that
 * are shipped. Its co-simulation is a Runge-Kutta method of order 4 with steps of at most FINE seconds, and events located by bisection. */
#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#define BALL 1  /* falls with g - u, bounces with restitution e, rests below the speed `slow`, is lifted again by u > g */
#define RELAY 2 /* x' = u ± g, reversed at ±e */
#define CLOCK 3 /* x' = number of ticks, one every g seconds */
#define KICK 4  /* x' = 0; after t = 0.5 a completed step asks for event mode, in which x becomes x + 1; ends after t = slow > 0 */
#define FUSSY 5 /* x'' = -g x + u; its derivatives refuse to be evaluated e times after t = 1, and are not numbers after t = slow > 0 */
#define STIFF 6 /* x' = u - x, v' = g (x - v) */

enum { TIME, U, X, V, DX, DV, Y, G, E, SLOW, LONGEST, COUNT, VARIABLES };

#if FMI == 2
#define F(name) fmi2##name
#define Flag int
#else
#define F(name) fmi3##name
#define Flag bool
#endif
#define EXPORT __attribute__((visibility("default"))) int
#define FINE 1e-3

typedef void Update(void *, double, bool, bool, bool, bool, bool *, double *);

typedef struct {
    double v[VARIABLES];
    int mode, tries; /* mode: the ball rests, the relay is on, the kick has been given */
    int failed;      /* a step was discarded, and no copy was restored since */
} Model;

typedef struct {
    Model m;
    double reached;
    bool events, early, terminate;
    void *environment;
    Update *update;
} Instance;

enum { OK, WARNING, DISCARD, ERROR };

static int slopes(Model *m) {
    double *v = m->v;
#if KIND == BALL
    v[DX] = m->mode ? 0.0 : v[V];
    v[DV] = m->mode ? 0.0 : v[U] - v[G];
#elif KIND == RELAY
    v[DX] = v[U] + (m->mode ? v[G] : -v[G]);
    v[DV] = 0.0;
#elif KIND == CLOCK
    v[DX] = v[COUNT];
    v[DV] = 0.0;
#elif KIND == KICK
    v[DX] = v[DV] = 0.0;
#elif KIND == FUSSY
    if (v[TIME] > 1.0 && m->tries < v[E]) {
        m->tries++;
        return DISCARD;
    }
    v[DX] = v[V];
    v[DV] = v[SLOW] > 0.0 && v[TIME] > v[SLOW] ? NAN : v[U] - v[G] * v[X];
#else
    v[DX] = v[U] - v[X];
    v[DV] = v[G] * (v[X] - v[V]);
#endif
    v[Y] = v[X];
    return OK;
}

static double indicator(const Model *m, int i) {
    const double *v = m->v;
#if KIND == BALL
    return i ? (m->mode ? v[G] - v[U] : 1.0) : (m->mode ? 1.0 : v[X]);
#elif KIND == RELAY
    return i ? 1.0 : m->mode ? v[E] - v[X] : v[X] + v[E];
#else
    return (void)v, (void)i, 1.0;
#endif
}

/* An event; returns whether a state has changed. */
static bool happen(Instance *c) {
    double *v = c->m.v;
#if KIND == BALL
    if (c->m.mode && v[U] > v[G]) {
        c->m.mode = 0;
        return false;
    }
    if (c->m.mode || v[X] > 0.0 || v[V] >= 0.0)
        return false;
    v[X] = 0x1p-300;
    v[V] *= -v[E];
    v[COUNT] += 1.0;
    if (v[V] < v[SLOW]) {
        v[V] = 0.0;
        c->m.mode = 1;
    }
    c->terminate = v[SLOW] < 0.0 && v[COUNT] >= -v[SLOW]; /* a negative one counts the bounces */
    return true;
#elif KIND == RELAY
    const int before = c->m.mode;
    c->m.mode = before ? v[X] < v[E] : v[X] <= -v[E];
    v[COUNT] += c->m.mode != before;
    return false;
#elif KIND == CLOCK
    if (v[TIME] >= (v[COUNT] + 1.0) * v[G] - 1e-12)
        v[COUNT] += 1.0;
    return false;
#elif KIND == KICK
    if (c->m.mode || v[TIME] <= 0.5)
        return false;
    c->m.mode = 1;
    v[X] += 1.0;
    return true;
#else
    return (void)v, false;
#endif
}

static double next_event(const Model *m) { return KIND == CLOCK ? (m->v[COUNT] + 1.0) * m->v[G] : INFINITY; }

static Instance *create(void *environment) {
    Instance *c = calloc(1, sizeof *c);
    c->m.v[G] = 1.0;
    c->environment = environment;
    return c;
}

/* Calls of both versions */

EXPORT F(SetDebugLogging)(void) { return OK; }
EXPORT F(EnterEventMode)(Instance *c) { return (void)c, OK; }
EXPORT F(EnterContinuousTimeMode)(Instance *c) { return (void)c, OK; }
EXPORT F(ExitInitializationMode)(Instance *c) { return slopes(&c->m) ? ERROR : OK; }
EXPORT F(Terminate)(Instance *c) { return (void)c, OK; }
EXPORT F(Reset)(Instance *c) { return memset(&c->m, 0, sizeof c->m), OK; }
__attribute__((visibility("default"))) void F(FreeInstance)(Instance *c) { free(c); }

static int get(Instance *c, const unsigned r[], size_t n, double values[]) {
    slopes(&c->m);
    for (size_t i = 0; i < n; i++)
        values[i] = c->m.v[r[i]];
    return OK;
}

static int set(Instance *c, const unsigned r[], size_t n, const double values[]) {
    for (size_t i = 0; i < n; i++)
        c->m.v[r[i]] = values[i];
    return OK;
}

EXPORT F(SetTime)(Instance *c, double t) { return c->m.v[TIME] = t, OK; }
EXPORT F(GetContinuousStates)(Instance *c, double x[], size_t n) { return memcpy(x, c->m.v + X, n * sizeof *x), OK; }
EXPORT F(SetContinuousStates)(Instance *c, const double x[], size_t n) { return memcpy(c->m.v + X, x, n * sizeof *x), OK; }
EXPORT F(GetNominalsOfContinuousStates)(Instance *c, double x[], size_t n) {
    for (size_t i = 0; i < n; i++)
        x[i] = KIND != FUSSY; /* a nominal of 0 is forbidden, and exported by some tools */
    return (void)c, OK;
}

static int derivatives(Instance *c, double dx[], size_t n) {
    const int status = slopes(&c->m);
    memcpy(dx, c->m.v + DX, n * sizeof *dx);
    return status;
}

EXPORT F(GetEventIndicators)(Instance *c, double z[], size_t n) {
    for (size_t i = 0; i < n; i++)
        z[i] = indicator(&c->m, (int)i);
    return OK;
}

EXPORT F(CompletedIntegratorStep)(Instance *c, int no_more, Flag *event, Flag *terminate) {
    *event = KIND == KICK && !c->m.mode && c->m.v[TIME] > 0.5;
    *terminate = KIND == KICK && c->m.v[SLOW] > 0.0 && c->m.v[TIME] > c->m.v[SLOW];
    return (void)no_more, OK;
}

/* Co-simulation */

static void input(Instance *c, double time) {
    bool stop = false;
    double when = 0.0;
    if (c->update)
        c->update(c->environment, time, true, true, false, false, &stop, &when);
}

static int runge_kutta(Instance *c, double h) {
    double *v = c->m.v, x[2] = {v[X], v[V]}, t = v[TIME], k[4][2];
    static const double part[] = {0.0, 0.5, 0.5, 1.0};
    for (int s = 0; s < 4; s++) {
        v[TIME] = t + part[s] * h;
        for (int i = 0; i < 2 && s; i++)
            v[X + i] = x[i] + part[s] * h * k[s - 1][i];
        input(c, v[TIME]);
        if (slopes(&c->m))
            return DISCARD;
        memcpy(k[s], v + DX, sizeof k[s]);
    }
    for (int i = 0; i < 2; i++)
        v[X + i] = x[i] + h * (k[0][i] + 2.0 * k[1][i] + 2.0 * k[2][i] + k[3][i]) / 6.0;
    return OK;
}

static int signs(Instance *c) { return (indicator(&c->m, 0) > 0.0) | (indicator(&c->m, 1) > 0.0) << 1; }

/* At most to `end`: stops at the first event, and says whether there was one. */
static bool advance(Instance *c, double end, int *status) {
    const double due = fmin(end, next_event(&c->m));
    while (c->m.v[TIME] < due) {
        const Model before = c->m;
        const int sign = signs(c);
        double h = fmin(FINE, due - before.v[TIME]);
        if ((*status = runge_kutta(c, h)))
            return false;
        if (signs(c) != sign) {
            double low = 0.0;
            while (h - low > 1e-15) {
                const double middle = 0.5 * (low + h);
                c->m = before;
                runge_kutta(c, middle);
                *(signs(c) == sign ? &low : &h) = middle;
            }
            c->m = before;
            runge_kutta(c, h);
            return true;
        }
        if (due - c->m.v[TIME] < 1e-13)
            c->m.v[TIME] = due;
    }
    return next_event(&c->m) <= end;
}

static int step(Instance *c, double time, double h, bool *event, bool *early) {
    double *v = c->m.v;
    const double end = time + h;
    int status = OK;
    *event = *early = false;
    c->reached = time;
    if (c->m.failed)
        return ERROR; /* only a restored copy of the state goes on */
    if (fabs(time - v[TIME]) > 1e-9)
        return ERROR;
    if (v[LONGEST] > 0.0 && h > v[LONGEST]) {
        c->m.failed = FMI == 2;
        return DISCARD;
    }
    while (advance(c, end, &status)) {
        *event = c->events;
        *early = c->events && c->early && v[TIME] < end;
        if (*event)
            break;
        happen(c);
        if (c->terminate)
            break;
    }
    c->reached = v[TIME];
    return status;
}

#if FMI == 2

__attribute__((visibility("default"))) void *fmi2Instantiate(void) { return create(NULL); }
EXPORT fmi2SetupExperiment(void) { return OK; }
EXPORT fmi2EnterInitializationMode(Instance *c) { return (void)c, OK; }
EXPORT fmi2GetReal(Instance *c, const unsigned r[], size_t n, double values[]) { return get(c, r, n, values); }
EXPORT fmi2SetReal(Instance *c, const unsigned r[], size_t n, const double values[]) { return set(c, r, n, values); }
EXPORT fmi2GetDerivatives(Instance *c, double dx[], size_t n) { return derivatives(c, dx, n); }

EXPORT fmi2NewDiscreteStates(Instance *c, int info[]) {
    const double next = (info[3] = happen(c), next_event(&c->m));
    info[0] = info[2] = 0;
    info[1] = c->terminate;
    info[4] = isfinite(next);
    memcpy(info + 6, &next, sizeof next);
    return OK;
}

EXPORT fmi2DoStep(Instance *c, double time, double h, int no_more) {
    bool event, early;
    const int status = step(c, time, h, &event, &early);
    return (void)no_more, c->terminate ? DISCARD : status;
}

EXPORT fmi2GetBooleanStatus(Instance *c, int kind, int *value) { return *value = c->terminate, kind == 3 ? OK : DISCARD; }
EXPORT fmi2GetRealStatus(Instance *c, int kind, double *value) { return *value = c->reached, kind == 2 ? OK : DISCARD; }

EXPORT fmi2GetFMUstate(Instance *c, Model **copy) {
    if (!*copy)
        *copy = malloc(sizeof **copy);
    return memcpy(*copy, &c->m, sizeof **copy), OK;
}

EXPORT fmi2SetFMUstate(Instance *c, Model *copy) { return memcpy(&c->m, copy, sizeof *copy), OK; }
EXPORT fmi2FreeFMUstate(Instance *c, Model **copy) { return (void)c, free(*copy), *copy = NULL, OK; }

#define MISSING(name) EXPORT fmi2##name(void) { return ERROR; }
MISSING(GetTypesPlatform) MISSING(GetVersion) MISSING(GetInteger) MISSING(GetBoolean) MISSING(GetString) MISSING(SetInteger)
MISSING(SetBoolean) MISSING(SetString) MISSING(SerializedFMUstateSize) MISSING(SerializeFMUstate) MISSING(DeSerializeFMUstate)
MISSING(GetDirectionalDerivative) MISSING(SetRealInputDerivatives) MISSING(GetRealOutputDerivatives) MISSING(CancelStep)
MISSING(GetStatus) MISSING(GetIntegerStatus) MISSING(GetStringStatus)

#else

__attribute__((visibility("default"))) void *fmi3InstantiateModelExchange(const char *name, const char *token, const char *path, bool visible,
                                                                          bool logging, void *environment, void *log) {
    return (void)name, (void)token, (void)path, (void)visible, (void)logging, (void)log, create(environment);
}

__attribute__((visibility("default"))) void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *path, bool visible,
                                                                         bool logging, bool events, bool early, const unsigned required[],
                                                                         size_t n, void *environment, void *log, Update *update) {
    (void)name, (void)token, (void)path, (void)visible, (void)logging, (void)log, (void)required;
    Instance *c = create(environment);
    c->events = events;
    c->early = early;
    c->update = n ? update : NULL;
    return c;
}

EXPORT fmi3EnterInitializationMode(Instance *c) { return (void)c, OK; }
EXPORT fmi3EnterStepMode(Instance *c) { return (void)c, OK; }
EXPORT fmi3GetFloat64(Instance *c, const unsigned r[], size_t n, double values[], size_t m) { return (void)m, get(c, r, n, values); }
EXPORT fmi3SetFloat64(Instance *c, const unsigned r[], size_t n, const double values[], size_t m) { return (void)m, set(c, r, n, values); }
EXPORT fmi3GetContinuousStateDerivatives(Instance *c, double dx[], size_t n) { return derivatives(c, dx, n); }
EXPORT fmi3GetNumberOfEventIndicators(Instance *c, size_t *n) { return (void)c, *n = 2, OK; }
EXPORT fmi3GetNumberOfContinuousStates(Instance *c, size_t *n) { return (void)c, *n = 2, OK; }

EXPORT fmi3UpdateDiscreteStates(Instance *c, bool *again, bool *terminate, bool *nominals, bool *states, bool *defined, double *next) {
    *states = happen(c);
    *terminate = c->terminate;
    *again = *nominals = false;
    *next = next_event(&c->m);
    *defined = isfinite(*next);
    return OK;
}

EXPORT fmi3DoStep(Instance *c, double time, double h, bool no_more, bool *event, bool *terminate, bool *early, double *reached) {
    const int status = step(c, time, h, event, early);
    *terminate = c->terminate;
    *reached = c->reached;
    return (void)no_more, status;
}

#define MISSING(name) EXPORT fmi3##name(void) { return ERROR; }
#define BOTH(type) MISSING(Get##type) MISSING(Set##type)
BOTH(Float32) BOTH(Int8) BOTH(UInt8) BOTH(Int16) BOTH(UInt16) BOTH(Int32) BOTH(UInt32) BOTH(Int64) BOTH(UInt64) BOTH(Boolean) BOTH(String)
BOTH(Binary) BOTH(Clock) BOTH(FMUState) BOTH(IntervalDecimal) BOTH(IntervalFraction) BOTH(ShiftDecimal) BOTH(ShiftFraction)
MISSING(GetVersion) MISSING(InstantiateScheduledExecution) MISSING(GetNumberOfVariableDependencies) MISSING(GetVariableDependencies)
MISSING(FreeFMUState) MISSING(SerializedFMUStateSize) MISSING(SerializeFMUState) MISSING(DeserializeFMUState)
MISSING(GetDirectionalDerivative) MISSING(GetAdjointDerivative) MISSING(EnterConfigurationMode) MISSING(ExitConfigurationMode)
MISSING(EvaluateDiscreteStates) MISSING(GetOutputDerivatives) MISSING(ActivateModelPartition)

#endif

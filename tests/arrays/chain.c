/* A chain of n masses of 1 kg joined by springs, as an FMI 3.0 FMU with arrays of every kind; n is a structural parameter.
 *
 *     x_i'' = gain · force_i · enabled + Σ over its springs of material² · stiffness · (neighbour - x_i)
 *
 * Spring i joins mass i to mass i + 1, the last one to a wall if `anchored`. Both interfaces; steps are divided into 1 ms of Runge-Kutta.
 * A call in a state where FMI does not allow it is an error: what a lenient FMU would forgive is found here.
 */
#define FMI3_OVERRIDE_FUNCTION_PREFIX
#include "fmi3Functions.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define MOST 64
#define TOKEN "{chain}"

enum { TIME, N, STIFFNESS, ANCHORED, GAIN, MATERIAL, FORCE, ENABLED, X, V, DX, DV, STATE, COUNT, LABEL, MOVED };

typedef enum { INSTANTIATED, CONFIGURING, INITIALIZING, RUNNING, EVENTS, CONTINUOUS, TERMINATED } Phase;

typedef struct {
    Phase phase;
    fmi3Boolean exchange;
    double time;
    size_t n;
    double stiffness[MOST], force[MOST], x[MOST], v[MOST], dx[MOST], dv[MOST];
    fmi3Boolean anchored, enabled;
    fmi3Int32 gain;
    fmi3Int64 material;
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
} Chain;

static fmi3Status complain(Chain *c, const char *words) {
    if (c->log)
        c->log(c->environment, fmi3Error, "logStatusError", words);
    return fmi3Error;
}

static void begin(Chain *c) {
    c->phase = INSTANTIATED;
    c->time = 0.0;
    c->n = 3;
    c->anchored = false, c->enabled = true, c->gain = 1, c->material = 1;
    for (int i = 0; i < MOST; i++)
        c->stiffness[i] = 1.0, c->force[i] = c->x[i] = c->v[i] = 0.0;
}

static void derivatives(Chain *c, const double *x, const double *v, double *dx, double *dv) {
    double hard = (double)(c->material * c->material);
    for (size_t i = 0; i < c->n; i++) {
        dx[i] = v[i];
        dv[i] = c->enabled ? c->gain * c->force[i] : 0.0;
    }
    for (size_t i = 0; i < c->n; i++) {
        double k = hard * c->stiffness[i];
        if (i + 1 < c->n) {
            dv[i] += k * (x[i + 1] - x[i]);
            dv[i + 1] -= k * (x[i + 1] - x[i]);
        } else if (c->anchored) {
            dv[i] -= k * x[i];
        }
    }
}

static void integrate(Chain *c, double h) {
    double k[4][2][MOST], x[MOST], v[MOST];
    const double at[4] = {0.0, 0.5, 0.5, 1.0};
    for (int s = 0; s < 4; s++) {
        for (size_t i = 0; i < c->n; i++) {
            x[i] = c->x[i] + (s ? h * at[s] * k[s - 1][0][i] : 0.0);
            v[i] = c->v[i] + (s ? h * at[s] * k[s - 1][1][i] : 0.0);
        }
        derivatives(c, x, v, k[s][0], k[s][1]);
    }
    for (size_t i = 0; i < c->n; i++) {
        c->x[i] += h / 6.0 * (k[0][0][i] + 2.0 * k[1][0][i] + 2.0 * k[2][0][i] + k[3][0][i]);
        c->v[i] += h / 6.0 * (k[0][1][i] + 2.0 * k[1][1][i] + 2.0 * k[2][1][i] + k[3][1][i]);
    }
}

static Chain *make(fmi3String token, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3Boolean exchange) {
    if (strcmp(token, TOKEN) != 0) {
        if (log)
            log(environment, fmi3Error, "logStatusError", "this library does not belong to this model description");
        return NULL;
    }
    Chain *c = calloc(1, sizeof(Chain));
    begin(c);
    c->environment = environment, c->log = log, c->exchange = exchange;
    return c;
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
                                         fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference required[], size_t count,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update) {
    (void)name, (void)resources, (void)visible, (void)logging, (void)events, (void)early, (void)required, (void)count, (void)update;
    return make(token, environment, log, false);
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
                                          fmi3InstanceEnvironment environment, fmi3LogMessageCallback log) {
    (void)name, (void)resources, (void)visible, (void)logging;
    return make(token, environment, log, true);
}

void fmi3FreeInstance(fmi3Instance c) { free(c); }

fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String categories[]) {
    (void)c, (void)on, (void)n, (void)categories;
    return fmi3OK;
}

static fmi3Status pass(Chain *c, Phase from, Phase to, const char *words) {
    if (c->phase != from)
        return complain(c, words);
    c->phase = to;
    return fmi3OK;
}

fmi3Status fmi3EnterConfigurationMode(fmi3Instance c) { return pass(c, INSTANTIATED, CONFIGURING, "configuration follows instantiation"); }

fmi3Status fmi3ExitConfigurationMode(fmi3Instance c) { return pass(c, CONFIGURING, INSTANTIATED, "this is not configuration mode"); }

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean has, fmi3Float64 tolerance, fmi3Float64 start, fmi3Boolean ends, fmi3Float64 stop) {
    (void)has, (void)tolerance, (void)start, (void)ends, (void)stop;
    return pass(c, INSTANTIATED, INITIALIZING, "initialisation follows instantiation");
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance c) {
    return pass(c, INITIALIZING, ((Chain *)c)->exchange ? EVENTS : RUNNING, "this is not initialisation mode");
}

fmi3Status fmi3Terminate(fmi3Instance c) {
    ((Chain *)c)->phase = TERMINATED;
    return fmi3OK;
}

fmi3Status fmi3Reset(fmi3Instance c) {
    begin(c);
    return fmi3OK;
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 t, fmi3Float64 h, fmi3Boolean keep, fmi3Boolean *events, fmi3Boolean *terminate,
                      fmi3Boolean *early, fmi3Float64 *last) {
    Chain *c = instance;
    (void)keep;
    if (c->phase != RUNNING)
        return complain(c, "a step before the end of initialisation");
    int count = (int)ceil(h / 1e-3 - 1e-9);
    for (int i = 0; i < count; i++)
        integrate(c, h / count);
    c->time = t + h;
    *events = *terminate = *early = false;
    *last = c->time;
    return fmi3OK;
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *again, fmi3Boolean *terminate, fmi3Boolean *nominals, fmi3Boolean *states,
                                    fmi3Boolean *next, fmi3Float64 *when) {
    *again = *terminate = *nominals = *states = *next = false, *when = 0.0;
    return ((Chain *)c)->phase == EVENTS ? fmi3OK : complain(c, "this is not event mode");
}

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance c) { return pass(c, EVENTS, CONTINUOUS, "this is not event mode"); }

fmi3Status fmi3EnterEventMode(fmi3Instance c) { return pass(c, CONTINUOUS, EVENTS, "this is not continuous-time mode"); }

fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 t) {
    ((Chain *)c)->time = t;
    return fmi3OK;
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean keep, fmi3Boolean *events, fmi3Boolean *terminate) {
    (void)c, (void)keep;
    *events = *terminate = false;
    return fmi3OK;
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n) {
    *n = 2 * ((Chain *)c)->n;
    return fmi3OK;
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n) {
    (void)c;
    *n = 0;
    return fmi3OK;
}

fmi3Status fmi3GetEventIndicators(fmi3Instance c, fmi3Float64 values[], size_t n) {
    (void)c, (void)values;
    return n ? fmi3Error : fmi3OK;
}

fmi3Status fmi3GetContinuousStates(fmi3Instance instance, fmi3Float64 x[], size_t n) {
    Chain *c = instance;
    if (n != 2 * c->n)
        return complain(c, "a wrong number of states");
    memcpy(x, c->x, c->n * sizeof *x), memcpy(x + c->n, c->v, c->n * sizeof *x);
    return fmi3OK;
}

fmi3Status fmi3SetContinuousStates(fmi3Instance instance, const fmi3Float64 x[], size_t n) {
    Chain *c = instance;
    if (n != 2 * c->n)
        return complain(c, "a wrong number of states");
    memcpy(c->x, x, c->n * sizeof *x), memcpy(c->v, x + c->n, c->n * sizeof *x);
    return fmi3OK;
}

fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) {
    (void)c;
    for (size_t i = 0; i < n; i++)
        x[i] = 1.0;
    return fmi3OK;
}

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance instance, fmi3Float64 d[], size_t n) {
    Chain *c = instance;
    if (n != 2 * c->n)
        return complain(c, "a wrong number of states");
    derivatives(c, c->x, c->v, d, d + c->n);
    return fmi3OK;
}

static double *column(Chain *c, fmi3ValueReference r) {
    switch (r) {
    case STIFFNESS: return c->stiffness;
    case FORCE: return c->force;
    case X: return c->x;
    case V: return c->v;
    case DX: return c->dx;
    case DV: return c->dv;
    default: return NULL;
    }
}

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference r[], size_t count, fmi3Float64 values[], size_t n) {
    Chain *c = instance;
    size_t used = 0;
    if (c->phase == INSTANTIATED || c->phase == CONFIGURING)
        return complain(c, "nothing can be read before initialisation");
    derivatives(c, c->x, c->v, c->dx, c->dv);
    for (size_t k = 0; k < count; k++) {
        double *from = column(c, r[k]);
        if (from && used + c->n <= n) {
            memcpy(values + used, from, c->n * sizeof *values), used += c->n;
        } else if (r[k] == STATE && used + 2 * c->n <= n) {
            for (size_t i = 0; i < c->n; i++)
                values[used++] = c->x[i], values[used++] = c->v[i];
        } else if (r[k] == TIME && used < n) {
            values[used++] = c->time;
        } else {
            return complain(c, "no such variable, or not the number of values that it has");
        }
    }
    return used == n ? fmi3OK : complain(c, "too many values");
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference r[], size_t count, const fmi3Float64 values[], size_t n) {
    Chain *c = instance;
    if (count * c->n != n)
        return complain(c, "not the number of values that the variables have");
    for (size_t k = 0; k < count; k++) {
        if (r[k] == FORCE ? c->phase == CONFIGURING : c->phase != INSTANTIATED && c->phase != INITIALIZING)
            return complain(c, "this cannot be set now");
        if (r[k] != FORCE && r[k] != STIFFNESS && r[k] != X && r[k] != V)
            return complain(c, "this cannot be set");
        memcpy(column(c, r[k]), values + k * c->n, c->n * sizeof *values);
    }
    return fmi3OK;
}

fmi3Status fmi3SetUInt64(fmi3Instance instance, const fmi3ValueReference r[], size_t count, const fmi3UInt64 values[], size_t n) {
    Chain *c = instance;
    if (c->phase != CONFIGURING || count != 1 || n != 1 || r[0] != N || values[0] < 1 || values[0] > MOST)
        return complain(c, "the number of masses is set in configuration mode, 1 to 64");
    c->n = values[0];
    return fmi3OK;
}

#define ACCESS(Type, ctype, REFERENCE, member)                                                                                              \
    fmi3Status fmi3Set##Type(fmi3Instance c, const fmi3ValueReference r[], size_t count, const ctype values[], size_t n) {                  \
        (void)n;                                                                                                                            \
        for (size_t k = 0; k < count; k++) {                                                                                                \
            if (r[k] != REFERENCE)                                                                                                          \
                return complain(c, "no such variable of this type");                                                                        \
            ((Chain *)c)->member = values[k];                                                                                               \
        }                                                                                                                                   \
        return fmi3OK;                                                                                                                      \
    }                                                                                                                                       \
    fmi3Status fmi3Get##Type(fmi3Instance c, const fmi3ValueReference r[], size_t count, ctype values[], size_t n) {                        \
        (void)n;                                                                                                                            \
        for (size_t k = 0; k < count; k++) {                                                                                                \
            if (r[k] != REFERENCE)                                                                                                          \
                return complain(c, "no such variable of this type");                                                                        \
            values[k] = ((Chain *)c)->member;                                                                                               \
        }                                                                                                                                   \
        return fmi3OK;                                                                                                                      \
    }

ACCESS(Int32, fmi3Int32, GAIN, gain)
ACCESS(Int64, fmi3Int64, MATERIAL, material)

fmi3Status fmi3SetBoolean(fmi3Instance instance, const fmi3ValueReference r[], size_t count, const fmi3Boolean values[], size_t n) {
    Chain *c = instance;
    (void)n;
    for (size_t k = 0; k < count; k++) {
        if (r[k] == ANCHORED && (c->phase == INSTANTIATED || c->phase == INITIALIZING))
            c->anchored = values[k];
        else if (r[k] == ENABLED)
            c->enabled = values[k];
        else
            return complain(c, "this cannot be set now");
    }
    return fmi3OK;
}

fmi3Status fmi3GetBoolean(fmi3Instance instance, const fmi3ValueReference r[], size_t count, fmi3Boolean values[], size_t n) {
    Chain *c = instance;
    size_t used = 0;
    for (size_t k = 0; k < count; k++) {
        if (r[k] == MOVED && used + c->n <= n) {
            for (size_t i = 0; i < c->n; i++)
                values[used++] = fabs(c->x[i]) > 1e-3;
        } else if (r[k] == ENABLED && used < n) {
            values[used++] = c->enabled;
        } else {
            return complain(c, "no such variable of this type");
        }
    }
    return fmi3OK;
}

fmi3Status fmi3GetUInt64(fmi3Instance instance, const fmi3ValueReference r[], size_t count, fmi3UInt64 values[], size_t n) {
    Chain *c = instance;
    (void)n;
    for (size_t k = 0; k < count; k++) {
        if (r[k] != N && r[k] != COUNT)
            return complain(c, "no such variable of this type");
        values[k] = c->n;
    }
    return fmi3OK;
}

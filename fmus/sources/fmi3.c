/* FMI 3.0: co-simulation and model exchange of a plant. Translates the standard's calls into those of instance.h. */
#include "instance.h"

#include <math.h>

#define FMI3_FUNCTION_PREFIX PLANT_PREFIX /* for importers that compile the sources; the shared library overrides it */
#include "fmi3Functions.h"

static fmi3Status translate(PlantStatus status) {
    switch (status) {
    case PLANT_OK:
    case PLANT_TERMINATE: /* the step was done; the request stands in an argument of fmi3DoStep */
        return fmi3OK;
    case PLANT_WARNING:
        return fmi3Warning;
    case PLANT_DISCARD:
        return fmi3Discard;
    case PLANT_FATAL:
        return fmi3Fatal;
    default:
        return fmi3Error;
    }
}

static void log_message(const Instance *c, PlantStatus status, const char *message) {
    static const char *const categories[] = {"logAll", "logStatusWarning", "logStatusDiscard", "logStatusError", "logStatusFatal", "logAll"};
    fmi3LogMessageCallback log = (fmi3LogMessageCallback)c->log;
    if (log && (c->logging || status == PLANT_ERROR || status == PLANT_FATAL))
        log(c->environment, translate(status), categories[status], message);
}

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean loggingOn, size_t nCategories, const fmi3String categories[]) {
    (void)nCategories, (void)categories;
    ((Instance *)c)->logging = loggingOn;
    return fmi3OK;
}

static fmi3Instance instantiate(fmi3String name, fmi3String token, int model_exchange, fmi3Boolean logging,
                                fmi3InstanceEnvironment environment, fmi3LogMessageCallback log) {
    Instance *c = create(name, model_exchange, environment, (void (*)(void))log, log_message);
    if (!c)
        return NULL;
    c->logging = logging;
    if (check_token(c, token) != PLANT_OK) {
        destroy(c);
        return NULL;
    }
    return c;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath,
                                          fmi3Boolean visible, fmi3Boolean loggingOn, fmi3InstanceEnvironment instanceEnvironment,
                                          fmi3LogMessageCallback logMessage) {
    (void)resourcePath, (void)visible;
    return instantiate(instanceName, instantiationToken, 1, loggingOn, instanceEnvironment, logMessage);
}

/* Within a step the importer sets the inputs that it has named. */
static void ask(void *owner, double time) {
    const Instance *c = owner;
    fmi3Boolean end = fmi3False;
    fmi3Float64 when = time;
    ((fmi3IntermediateUpdateCallback)c->update)(c->environment, time, fmi3True, fmi3False, fmi3False, fmi3False, &end, &when);
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath,
                                         fmi3Boolean visible, fmi3Boolean loggingOn, fmi3Boolean eventModeUsed,
                                         fmi3Boolean earlyReturnAllowed, const fmi3ValueReference requiredIntermediateVariables[],
                                         size_t nRequiredIntermediateVariables, fmi3InstanceEnvironment instanceEnvironment,
                                         fmi3LogMessageCallback logMessage, fmi3IntermediateUpdateCallback intermediateUpdate) {
    (void)resourcePath, (void)visible, (void)requiredIntermediateVariables;
    Instance *c = instantiate(instanceName, instantiationToken, 0, loggingOn, instanceEnvironment, logMessage);
    if (c) {
        c->event_mode = eventModeUsed;
        c->early_return = earlyReturnAllowed;
    }
    if (c && eventModeUsed && !PLANT_HAS_EVENTS) {
        report(c, PLANT_ERROR, "co-simulation of this model has no event mode (hasEventMode is false)");
        destroy(c);
        return NULL;
    }
    if (c && nRequiredIntermediateVariables && intermediateUpdate) {
        c->update = (void (*)(void))intermediateUpdate;
        c->source = (InputSource){ask, c};
    }
    return c;
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath,
                                               fmi3Boolean visible, fmi3Boolean loggingOn, fmi3InstanceEnvironment instanceEnvironment,
                                               fmi3LogMessageCallback logMessage, fmi3ClockUpdateCallback clockUpdate,
                                               fmi3LockPreemptionCallback lockPreemption, fmi3UnlockPreemptionCallback unlockPreemption) {
    (void)instanceName, (void)instantiationToken, (void)resourcePath, (void)visible, (void)loggingOn, (void)instanceEnvironment;
    (void)logMessage, (void)clockUpdate, (void)lockPreemption, (void)unlockPreemption;
    return NULL;
}

void fmi3FreeInstance(fmi3Instance c) { destroy(c); }

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean toleranceDefined, fmi3Float64 tolerance, fmi3Float64 startTime,
                                       fmi3Boolean stopTimeDefined, fmi3Float64 stopTime) {
    (void)toleranceDefined, (void)tolerance; /* the integrator's own tolerance is at the limit of double precision */
    if (require(c, "fmi3EnterInitializationMode", IN(CREATED)) != PLANT_OK || set_experiment(c, startTime, stopTimeDefined, stopTime) != PLANT_OK)
        return fmi3Error;
    return translate(enter(c, "fmi3EnterInitializationMode", IN(CREATED), INITIALIZING));
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance c) {
    const Instance *instance = c;
    const Phase next = instance->model_exchange || instance->event_mode ? EVENTS : STEPPING;
    return translate(enter(c, "fmi3ExitInitializationMode", IN(INITIALIZING), next));
}

fmi3Status fmi3EnterEventMode(fmi3Instance c) {
    const unsigned from = ((Instance *)c)->event_mode ? IN(STEPPING) : IN(CONTINUOUS);
    return translate(enter(c, "fmi3EnterEventMode", from, EVENTS));
}

fmi3Status fmi3EnterStepMode(fmi3Instance c) {
    const unsigned from = ((Instance *)c)->event_mode ? IN(EVENTS) : 0;
    return translate(enter(c, "fmi3EnterStepMode", from, STEPPING));
}

fmi3Status fmi3Terminate(fmi3Instance c) {
    return translate(enter(c, "fmi3Terminate", IN(EVENTS) | IN(CONTINUOUS) | IN(STEPPING), TERMINATED));
}

fmi3Status fmi3Reset(fmi3Instance c) { return translate(reset(c)); }

/* Every variable is a scalar, so there are as many values as references. */
static PlantStatus check_sizes(const Instance *c, size_t references, size_t values) {
    if (references == values)
        return PLANT_OK;
    return report(c, PLANT_ERROR, "%zu scalar variables have %zu values, not %zu", references, references, values);
}

fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t nvr, fmi3Float64 values[], size_t nValues) {
    return check_sizes(c, nvr, nValues) == PLANT_OK ? translate(get_values(c, REAL, vr, nvr, values)) : fmi3Error;
}

fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t nvr, const fmi3Float64 values[], size_t nValues) {
    return check_sizes(c, nvr, nValues) == PLANT_OK ? translate(set_values(c, REAL, vr, nvr, values)) : fmi3Error;
}

fmi3Status fmi3GetBoolean(fmi3Instance c, const fmi3ValueReference vr[], size_t nvr, fmi3Boolean values[], size_t nValues) {
    double number;
    if (check_sizes(c, nvr, nValues) != PLANT_OK)
        return fmi3Error;
    for (size_t i = 0; i < nvr; i++) {
        if (get_values(c, BOOLEAN, &vr[i], 1, &number) != PLANT_OK)
            return fmi3Error;
        values[i] = number != 0.0;
    }
    return fmi3OK;
}

fmi3Status fmi3SetBoolean(fmi3Instance c, const fmi3ValueReference vr[], size_t nvr, const fmi3Boolean values[], size_t nValues) {
    if (check_sizes(c, nvr, nValues) != PLANT_OK)
        return fmi3Error;
    for (size_t i = 0; i < nvr; i++) {
        const double number = values[i];
        if (set_values(c, BOOLEAN, &vr[i], 1, &number) != PLANT_OK)
            return fmi3Error;
    }
    return fmi3OK;
}

/* There are no variables of other types; asking for none of them is fine. */
#define NO_SUCH_VARIABLES(function) (nvr ? translate(report(c, PLANT_ERROR, #function ": there are no such variables")) : fmi3OK)

#define NO_VARIABLES(function, type)                                                                                \
    fmi3Status function(fmi3Instance c, const fmi3ValueReference vr[], size_t nvr, type values[], size_t nValues) { \
        (void)vr, (void)values, (void)nValues;                                                                      \
        return NO_SUCH_VARIABLES(function);                                                                         \
    }

NO_VARIABLES(fmi3GetFloat32, fmi3Float32)
NO_VARIABLES(fmi3GetInt8, fmi3Int8)
NO_VARIABLES(fmi3GetUInt8, fmi3UInt8)
NO_VARIABLES(fmi3GetInt16, fmi3Int16)
NO_VARIABLES(fmi3GetUInt16, fmi3UInt16)
NO_VARIABLES(fmi3GetInt32, fmi3Int32)
NO_VARIABLES(fmi3GetUInt32, fmi3UInt32)
NO_VARIABLES(fmi3GetInt64, fmi3Int64)
NO_VARIABLES(fmi3GetUInt64, fmi3UInt64)
NO_VARIABLES(fmi3GetString, fmi3String)
NO_VARIABLES(fmi3SetFloat32, const fmi3Float32)
NO_VARIABLES(fmi3SetInt8, const fmi3Int8)
NO_VARIABLES(fmi3SetUInt8, const fmi3UInt8)
NO_VARIABLES(fmi3SetInt16, const fmi3Int16)
NO_VARIABLES(fmi3SetUInt16, const fmi3UInt16)
NO_VARIABLES(fmi3SetInt32, const fmi3Int32)
NO_VARIABLES(fmi3SetUInt32, const fmi3UInt32)
NO_VARIABLES(fmi3SetInt64, const fmi3Int64)
NO_VARIABLES(fmi3SetUInt64, const fmi3UInt64)
NO_VARIABLES(fmi3SetString, const fmi3String)

fmi3Status fmi3GetBinary(fmi3Instance c, const fmi3ValueReference vr[], size_t nvr, size_t sizes[], fmi3Binary values[], size_t nValues) {
    (void)vr, (void)sizes, (void)values, (void)nValues;
    return NO_SUCH_VARIABLES(fmi3GetBinary);
}

fmi3Status fmi3SetBinary(fmi3Instance c, const fmi3ValueReference vr[], size_t nvr, const size_t sizes[], const fmi3Binary values[],
                         size_t nValues) {
    (void)vr, (void)sizes, (void)values, (void)nValues;
    return NO_SUCH_VARIABLES(fmi3SetBinary);
}

#define NO_CLOCKS(function, ...)                                                                       \
    fmi3Status function(fmi3Instance c, const fmi3ValueReference vr[], size_t nvr, __VA_ARGS__) { \
        (void)vr;                                                                                      \
        return NO_SUCH_VARIABLES(function);                                                            \
    }

NO_CLOCKS(fmi3GetClock, UNUSED fmi3Clock values[])
NO_CLOCKS(fmi3SetClock, UNUSED const fmi3Clock values[])
NO_CLOCKS(fmi3GetIntervalDecimal, UNUSED fmi3Float64 intervals[], UNUSED fmi3IntervalQualifier qualifiers[])
NO_CLOCKS(fmi3GetIntervalFraction, UNUSED fmi3UInt64 counters[], UNUSED fmi3UInt64 resolutions[], UNUSED fmi3IntervalQualifier qualifiers[])
NO_CLOCKS(fmi3GetShiftDecimal, UNUSED fmi3Float64 shifts[])
NO_CLOCKS(fmi3GetShiftFraction, UNUSED fmi3UInt64 counters[], UNUSED fmi3UInt64 resolutions[])
NO_CLOCKS(fmi3SetIntervalDecimal, UNUSED const fmi3Float64 intervals[])
NO_CLOCKS(fmi3SetIntervalFraction, UNUSED const fmi3UInt64 counters[], UNUSED const fmi3UInt64 resolutions[])
NO_CLOCKS(fmi3SetShiftDecimal, UNUSED const fmi3Float64 shifts[])
NO_CLOCKS(fmi3SetShiftFraction, UNUSED const fmi3UInt64 counters[], UNUSED const fmi3UInt64 resolutions[])

fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance c, fmi3ValueReference vr, size_t *n) {
    (void)vr, (void)n;
    return translate(report(c, PLANT_ERROR, "dependencies do not change: see the model description"));
}

fmi3Status fmi3GetVariableDependencies(fmi3Instance c, fmi3ValueReference dependent, size_t indices[], fmi3ValueReference independents[],
                                       size_t independentIndices[], fmi3DependencyKind kinds[], size_t n) {
    (void)dependent, (void)indices, (void)independents, (void)independentIndices, (void)kinds, (void)n;
    return translate(report(c, PLANT_ERROR, "dependencies do not change: see the model description"));
}

fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *FMUState) { return translate(save_state(c, FMUState)); }
fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState FMUState) { return translate(restore_state(c, FMUState)); }

fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *FMUState) {
    (void)c;
    free_state(FMUState);
    return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState FMUState, size_t *size) {
    (void)c, (void)FMUState;
    *size = serialized_size();
    return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState FMUState, fmi3Byte serializedState[], size_t size) {
    return translate(serialize(c, FMUState, serializedState, size));
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte serializedState[], size_t size, fmi3FMUState *FMUState) {
    return translate(deserialize(c, serializedState, size, FMUState));
}

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance c, const fmi3ValueReference unknowns[], size_t nUnknowns,
                                        const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[], size_t nSeed,
                                        fmi3Float64 sensitivity[], size_t nSensitivity) {
    if (check_sizes(c, nKnowns, nSeed) != PLANT_OK || check_sizes(c, nUnknowns, nSensitivity) != PLANT_OK)
        return fmi3Error;
    return translate(directional(c, unknowns, nUnknowns, knowns, nKnowns, seed, sensitivity));
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance c, const fmi3ValueReference unknowns[], size_t nUnknowns,
                                    const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[], size_t nSeed,
                                    fmi3Float64 sensitivity[], size_t nSensitivity) {
    if (check_sizes(c, nUnknowns, nSeed) != PLANT_OK || check_sizes(c, nKnowns, nSensitivity) != PLANT_OK)
        return fmi3Error;
    return translate(adjoint(c, unknowns, nUnknowns, knowns, nKnowns, seed, sensitivity));
}

#define UNSUPPORTED(function) \
    fmi3Status function(fmi3Instance c) { return translate(report(c, PLANT_ERROR, #function ": this model has no such mode")); }

UNSUPPORTED(fmi3EnterConfigurationMode)
UNSUPPORTED(fmi3ExitConfigurationMode)

fmi3Status fmi3ActivateModelPartition(fmi3Instance c, fmi3ValueReference clockReference, fmi3Float64 activationTime) {
    (void)clockReference, (void)activationTime;
    return translate(report(c, PLANT_ERROR, "fmi3ActivateModelPartition: this model has no such mode"));
}

fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance c) {
    return translate(require(c, "fmi3EvaluateDiscreteStates", IN(INITIALIZING) | IN(EVENTS)));
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *discreteStatesNeedUpdate, fmi3Boolean *terminateSimulation,
                                    fmi3Boolean *nominalsOfContinuousStatesChanged, fmi3Boolean *valuesOfContinuousStatesChanged,
                                    fmi3Boolean *nextEventTimeDefined, fmi3Float64 *nextEventTime) {
    *discreteStatesNeedUpdate = *terminateSimulation = fmi3False;
    *nominalsOfContinuousStatesChanged = *valuesOfContinuousStatesChanged = fmi3False;
    const PlantStatus status = update_discrete(c, "fmi3UpdateDiscreteStates", nextEventTime);
    *nextEventTimeDefined = isfinite(*nextEventTime);
    return translate(status);
}

/* Model exchange */

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance c) {
    return translate(enter(c, "fmi3EnterContinuousTimeMode", IN(EVENTS), CONTINUOUS));
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean noSetFMUStatePriorToCurrentPoint, fmi3Boolean *enterEventMode,
                                       fmi3Boolean *terminateSimulation) {
    (void)noSetFMUStatePriorToCurrentPoint;
    int terminate;
    const PlantStatus status = complete_step(c, "fmi3CompletedIntegratorStep", &terminate);
    *enterEventMode = fmi3False;
    *terminateSimulation = terminate;
    return translate(status);
}

fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 time) {
    if (require(c, "fmi3SetTime", IN(EVENTS) | IN(CONTINUOUS)) != PLANT_OK)
        return fmi3Error;
    return translate(set_time(c, time));
}

fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 states[], size_t n) {
    if (require(c, "fmi3SetContinuousStates", IN(CONTINUOUS)) != PLANT_OK)
        return fmi3Error;
    return translate(set_states(c, states, n));
}

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 derivatives[], size_t n) {
    return translate(get_derivatives(c, derivatives, n));
}

fmi3Status fmi3GetEventIndicators(fmi3Instance c, fmi3Float64 indicators[], size_t n) {
    (void)indicators;
    return n ? translate(report(c, PLANT_ERROR, "there are no event indicators")) : fmi3OK;
}

fmi3Status fmi3GetContinuousStates(fmi3Instance c, fmi3Float64 states[], size_t n) { return translate(get_states(c, states, n)); }
fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, fmi3Float64 nominals[], size_t n) {
    return translate(get_nominals(c, nominals, n));
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n) {
    (void)c;
    *n = 0;
    return fmi3OK;
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n) {
    (void)c;
    *n = PLANT_STATES;
    return fmi3OK;
}

/* Co-simulation */

fmi3Status fmi3GetOutputDerivatives(fmi3Instance c, const fmi3ValueReference vr[], size_t nvr, const fmi3Int32 orders[],
                                    fmi3Float64 values[], size_t nValues) {
    (void)vr, (void)orders, (void)values, (void)nValues;
    return nvr ? translate(report(c, PLANT_ERROR, "derivatives of outputs are not provided")) : fmi3OK;
}

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 currentCommunicationPoint, fmi3Float64 communicationStepSize,
                      fmi3Boolean noSetFMUStatePriorToCurrentPoint, fmi3Boolean *eventHandlingNeeded, fmi3Boolean *terminateSimulation,
                      fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime) {
    (void)noSetFMUStatePriorToCurrentPoint;
    const PlantStatus status = do_step(c, currentCommunicationPoint, communicationStepSize);
    const State *s = &((Instance *)c)->state;
    *terminateSimulation = status == PLANT_TERMINATE;
    *eventHandlingNeeded = status == PLANT_OK && s->event;
    *earlyReturn = *eventHandlingNeeded && s->plant.time < currentCommunicationPoint + communicationStepSize;
    *lastSuccessfulTime = s->plant.time;
    return translate(status);
}

/* FMI 2.0: co-simulation and model exchange of a plant. Translates the standard's calls into those of instance.h. */
#include "instance.h"

#include <math.h>

#include "fmi2Functions.h"

static fmi2Status translate(PlantStatus status) {
    switch (status) {
    case PLANT_OK:
        return fmi2OK;
    case PLANT_WARNING:
        return fmi2Warning;
    case PLANT_DISCARD:
    case PLANT_TERMINATE: /* with fmi2Terminated true */
        return fmi2Discard;
    case PLANT_FATAL:
        return fmi2Fatal;
    default:
        return fmi2Error;
    }
}

static void log_message(const Instance *c, PlantStatus status, const char *message) {
    static const char *const categories[] = {"logAll", "logStatusWarning", "logStatusDiscard", "logStatusError", "logStatusFatal", "logAll"};
    fmi2CallbackLogger log = (fmi2CallbackLogger)c->log;
    if (log && (c->logging || status == PLANT_ERROR || status == PLANT_FATAL))
        log(c->environment, c->name, translate(status), categories[status], "%s", message);
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t nCategories, const fmi2String categories[]) {
    (void)nCategories, (void)categories;
    ((Instance *)c)->logging = loggingOn;
    return fmi2OK;
}

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID, fmi2String fmuResourceLocation,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean loggingOn) {
    (void)fmuResourceLocation, (void)visible;
    void (*log)(void) = functions ? (void (*)(void))functions->logger : NULL;
    Instance *c = create(instanceName, fmuType == fmi2ModelExchange, functions ? functions->componentEnvironment : NULL, log, log_message);
    if (!c)
        return NULL;
    c->logging = loggingOn;
    if (check_token(c, fmuGUID) != PLANT_OK) {
        destroy(c);
        return NULL;
    }
    return c;
}

void fmi2FreeInstance(fmi2Component c) { destroy(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real startTime,
                               fmi2Boolean stopTimeDefined, fmi2Real stopTime) {
    (void)toleranceDefined, (void)tolerance; /* the integrator's own tolerance is at the limit of double precision */
    if (require(c, "fmi2SetupExperiment", IN(CREATED)) != PLANT_OK)
        return fmi2Error;
    return translate(set_experiment(c, startTime, stopTimeDefined, stopTime));
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    return translate(enter(c, "fmi2EnterInitializationMode", IN(CREATED), INITIALIZING));
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    const Phase next = ((Instance *)c)->model_exchange ? EVENTS : STEPPING;
    return translate(enter(c, "fmi2ExitInitializationMode", IN(INITIALIZING), next));
}

fmi2Status fmi2Terminate(fmi2Component c) {
    return translate(enter(c, "fmi2Terminate", IN(EVENTS) | IN(CONTINUOUS) | IN(STEPPING), TERMINATED));
}

fmi2Status fmi2Reset(fmi2Component c) { return translate(reset(c)); }

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Real value[]) {
    return translate(get_values(c, REAL, vr, nvr, value));
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Real value[]) {
    return translate(set_values(c, REAL, vr, nvr, value));
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Boolean value[]) {
    double number;
    for (size_t i = 0; i < nvr; i++) {
        if (get_values(c, BOOLEAN, &vr[i], 1, &number) != PLANT_OK)
            return fmi2Error;
        value[i] = number != 0.0;
    }
    return fmi2OK;
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Boolean value[]) {
    for (size_t i = 0; i < nvr; i++) {
        const double number = value[i] != fmi2False;
        if (set_values(c, BOOLEAN, &vr[i], 1, &number) != PLANT_OK)
            return fmi2Error;
    }
    return fmi2OK;
}

/* There are no variables of other types; asking for none of them is fine. */
#define NO_VARIABLES(function, type)                                                                      \
    fmi2Status function(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, type value[]) {       \
        (void)vr, (void)value;                                                                            \
        return nvr ? translate(report(c, PLANT_ERROR, #function ": there are no such variables")) : fmi2OK; \
    }

NO_VARIABLES(fmi2GetInteger, fmi2Integer)
NO_VARIABLES(fmi2GetString, fmi2String)
NO_VARIABLES(fmi2SetInteger, const fmi2Integer)
NO_VARIABLES(fmi2SetString, const fmi2String)

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate) { return translate(save_state(c, FMUstate)); }
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate) { return translate(restore_state(c, FMUstate)); }

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate) {
    (void)c;
    free_state(FMUstate);
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size) {
    (void)c, (void)FMUstate;
    *size = serialized_size();
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[], size_t size) {
    return translate(serialize(c, FMUstate, (unsigned char *)serializedState, size));
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size, fmi2FMUstate *FMUstate) {
    return translate(deserialize(c, (const unsigned char *)serializedState, size, FMUstate));
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference vUnknown_ref[], size_t nUnknown,
                                        const fmi2ValueReference vKnown_ref[], size_t nKnown, const fmi2Real dvKnown[],
                                        fmi2Real dvUnknown[]) {
    return translate(directional(c, vUnknown_ref, nUnknown, vKnown_ref, nKnown, dvKnown, dvUnknown));
}

/* Model exchange */

fmi2Status fmi2EnterEventMode(fmi2Component c) { return translate(enter(c, "fmi2EnterEventMode", IN(CONTINUOUS), EVENTS)); }

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *eventInfo) {
    eventInfo->newDiscreteStatesNeeded = fmi2False;
    eventInfo->terminateSimulation = fmi2False;
    eventInfo->nominalsOfContinuousStatesChanged = fmi2False;
    eventInfo->valuesOfContinuousStatesChanged = fmi2False;
    const PlantStatus status = update_discrete(c, "fmi2NewDiscreteStates", &eventInfo->nextEventTime);
    eventInfo->nextEventTimeDefined = isfinite(eventInfo->nextEventTime);
    return translate(status);
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) {
    return translate(enter(c, "fmi2EnterContinuousTimeMode", IN(EVENTS), CONTINUOUS));
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean noSetFMUStatePriorToCurrentPoint, fmi2Boolean *enterEventMode,
                                       fmi2Boolean *terminateSimulation) {
    (void)noSetFMUStatePriorToCurrentPoint;
    int terminate;
    const PlantStatus status = complete_step(c, "fmi2CompletedIntegratorStep", &terminate);
    *enterEventMode = fmi2False;
    *terminateSimulation = terminate;
    return translate(status);
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) {
    if (require(c, "fmi2SetTime", IN(EVENTS) | IN(CONTINUOUS)) != PLANT_OK)
        return fmi2Error;
    return translate(set_time(c, time));
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t nx) {
    if (require(c, "fmi2SetContinuousStates", IN(CONTINUOUS)) != PLANT_OK)
        return fmi2Error;
    return translate(set_states(c, x, nx));
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real derivatives[], size_t nx) { return translate(get_derivatives(c, derivatives, nx)); }

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real eventIndicators[], size_t ni) {
    (void)eventIndicators;
    return ni ? translate(report(c, PLANT_ERROR, "there are no event indicators")) : fmi2OK;
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t nx) { return translate(get_states(c, x, nx)); }
fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x_nominal[], size_t nx) {
    return translate(get_nominals(c, x_nominal, nx));
}

/* Co-simulation */

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Integer order[],
                                       const fmi2Real value[]) {
    for (size_t i = 0; i < nvr; i++)
        if (set_input_derivative(c, vr[i], order[i], value[i]) != PLANT_OK)
            return fmi2Error;
    return fmi2OK;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Integer order[],
                                        fmi2Real value[]) {
    (void)vr, (void)order, (void)value;
    return nvr ? translate(report(c, PLANT_ERROR, "derivatives of outputs are not provided")) : fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint) {
    (void)noSetFMUStatePriorToCurrentPoint;
    return translate(do_step(c, currentCommunicationPoint, communicationStepSize));
}

fmi2Status fmi2CancelStep(fmi2Component c) { return translate(report(c, PLANT_ERROR, "no step is running that could be cancelled")); }

/* Steps are never asynchronous, so only two things can be asked for. */
fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind s, fmi2Boolean *value) {
    if (s != fmi2Terminated)
        return fmi2Discard;
    *value = ((Instance *)c)->state.terminate;
    return fmi2OK;
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind s, fmi2Real *value) {
    if (s != fmi2LastSuccessfulTime)
        return fmi2Discard;
    *value = ((Instance *)c)->state.plant.time;
    return fmi2OK;
}

#define NO_STATUS(function, type)                                                 \
    fmi2Status function(fmi2Component c, const fmi2StatusKind s, type *value) { \
        (void)c, (void)s, (void)value;                                            \
        return fmi2Discard;                                                       \
    }

NO_STATUS(fmi2GetStatus, fmi2Status)
NO_STATUS(fmi2GetIntegerStatus, fmi2Integer)
NO_STATUS(fmi2GetStringStatus, fmi2String)


typedef void (*Logger)(void *environment, int status, const char *category, const char *message);

static void tell(const Instance *i, const char *text)
{
    if (i->logger) {
        ((Logger)i->logger)(i->environment, ERROR, "logStatusError", text);
    }
}

EXPORTED(void *, fmi3InstantiateCoSimulation)(
    const char *name, const char *given, const char *resources, bool visible, bool logging, bool event_mode, bool early,
    const uint32_t intermediate[], size_t n, void *environment, Logger logger, void (*update)(void))
{
    (void)resources, (void)visible, (void)logging, (void)event_mode, (void)early, (void)intermediate, (void)n;
    (void)update;
    return instantiate(name, given, (void (*)(void))logger, environment);
}

EXPORTED(void *, fmi3InstantiateModelExchange)(void) { return NULL; }
EXPORTED(void *, fmi3InstantiateScheduledExecution)(void) { return NULL; }
EXPORTED(int, fmi3EnterInitializationMode)(
    Instance *i, bool tolerance_defined, double tolerance, double start, bool stop_defined, double stop)
{
    (void)tolerance_defined, (void)tolerance, (void)stop_defined, (void)stop;
    return enter(&i->now, INITIALIZING, start);
}

EXPORTED(int, fmi3DoStep)(
    Instance *i, double at, double size, bool no_return, bool *event, bool *terminate, bool *early, double *reached)
{
    const int status = advance(i, size);
    (void)at, (void)no_return;
    *event = *terminate = *early = false;
    *reached = i->now.time;
    return status;
}

#define ROOM , size_t room
VALUES(Float32, float, 'f', "f", ROOM, room)
VALUES(Float64, double, 'd', "d", ROOM, room)
VALUES(Int8, int8_t, 'c', "c", ROOM, room)
VALUES(UInt8, uint8_t, 'C', "C", ROOM, room)
VALUES(Int16, int16_t, 'h', "h", ROOM, room)
VALUES(UInt16, uint16_t, 'H', "H", ROOM, room)
VALUES(Int32, int32_t, 'i', "i", ROOM, room)
VALUES(UInt32, uint32_t, 'u', "u", ROOM, room)
VALUES(Int64, int64_t, ' ', "", ROOM, room) /* no variable has these two types */
VALUES(UInt64, uint64_t, ' ', "", ROOM, room)
VALUES(Boolean, bool, 'b', "b", ROOM, room)

REFUSED(ActivateModelPartition) REFUSED(CompletedIntegratorStep) REFUSED(EnterConfigurationMode)
REFUSED(EnterContinuousTimeMode) REFUSED(EnterEventMode) REFUSED(EnterStepMode) REFUSED(EvaluateDiscreteStates)
REFUSED(ExitConfigurationMode) REFUSED(GetAdjointDerivative) REFUSED(GetBinary) REFUSED(GetClock)
REFUSED(GetContinuousStateDerivatives) REFUSED(GetContinuousStates) REFUSED(GetDirectionalDerivative)
REFUSED(GetEventIndicators) REFUSED(GetIntervalDecimal) REFUSED(GetIntervalFraction)
REFUSED(GetNominalsOfContinuousStates) REFUSED(GetNumberOfContinuousStates) REFUSED(GetNumberOfEventIndicators)
REFUSED(GetNumberOfVariableDependencies) REFUSED(GetOutputDerivatives) REFUSED(GetShiftDecimal)
REFUSED(GetShiftFraction) REFUSED(GetString) REFUSED(GetVariableDependencies) REFUSED(SetBinary) REFUSED(SetClock)
REFUSED(SetContinuousStates) REFUSED(SetIntervalDecimal) REFUSED(SetIntervalFraction) REFUSED(SetShiftDecimal)
REFUSED(SetShiftFraction) REFUSED(SetString) REFUSED(SetTime) REFUSED(UpdateDiscreteStates)

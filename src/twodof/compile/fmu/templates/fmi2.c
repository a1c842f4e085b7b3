
/* The head of FMI's struct of callbacks; its other members are not used. */
typedef void (*Logger)(void *environment, const char *instance, int status, const char *category, const char *text, ...);
typedef struct {
    Logger logger;
    void (*unused[3])(void);
    void *environment;
} Callbacks;

static void tell(const Instance *i, const char *text)
{
    if (i->logger) {
        ((Logger)i->logger)(i->environment, i->name, ERROR, "logStatusError", "%s", text);
    }
}

EXPORTED(const char *, fmi2GetTypesPlatform)(void) { return "default"; }
EXPORTED(void *, fmi2Instantiate)(
    const char *name, int type, const char *given, const char *resources, const Callbacks *callbacks, int visible,
    int logging)
{
    const bool co_simulation = type == 1;
    (void)resources, (void)visible, (void)logging;
    return co_simulation && callbacks
        ? instantiate(name, given, (void (*)(void))callbacks->logger, callbacks->environment)
        : NULL;
}

EXPORTED(int, fmi2SetupExperiment)(
    Instance *i, int tolerance_defined, double tolerance, double start, int stop_defined, double stop)
{
    (void)tolerance_defined, (void)tolerance, (void)stop_defined, (void)stop;
    return enter(&i->now, INSTANTIATED, start);
}

EXPORTED(int, fmi2EnterInitializationMode)(Instance *i) { return enter(&i->now, INITIALIZING, i->now.start); }
EXPORTED(int, fmi2DoStep)(Instance *i, double at, double size, int no_return)
{ return (void)at, (void)no_return, advance(i, size); }

/* FMI 2.0 has scalars only: one value for each reference. */
VALUES(Real, double, 'd', "fd", , SIZE_MAX)
VALUES(Integer, int, 'i', "icChH", , SIZE_MAX)
VALUES(Boolean, int, 'i', "b", , SIZE_MAX)

REFUSED(CancelStep) REFUSED(CompletedIntegratorStep) REFUSED(EnterContinuousTimeMode) REFUSED(EnterEventMode)
REFUSED(GetBooleanStatus) REFUSED(GetContinuousStates) REFUSED(GetDerivatives) REFUSED(GetDirectionalDerivative)
REFUSED(GetEventIndicators) REFUSED(GetIntegerStatus) REFUSED(GetNominalsOfContinuousStates)
REFUSED(GetRealOutputDerivatives) REFUSED(GetRealStatus) REFUSED(GetStatus) REFUSED(GetString)
REFUSED(GetStringStatus) REFUSED(NewDiscreteStates) REFUSED(SetContinuousStates) REFUSED(SetRealInputDerivatives)
REFUSED(SetString) REFUSED(SetTime)

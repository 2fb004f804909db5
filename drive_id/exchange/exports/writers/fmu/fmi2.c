/* FMI 2.0, model exchange and co-simulation, over model.h. Numbers and structures are those of the standard's C interface. */
#define FMI(name) fmi2##name
#define fmi2GetFMUState fmi2GetFMUstate
#define fmi2SetFMUState fmi2SetFMUstate
#define fmi2FreeFMUState fmi2FreeFMUstate
#define fmi2SerializedFMUStateSize fmi2SerializedFMUstateSize
#define fmi2SerializeFMUState fmi2SerializeFMUstate
#define fmi2DeserializeFMUState fmi2DeSerializeFMUstate
#define fmi2GetContinuousStateDerivatives fmi2GetDerivatives
typedef void (*Logger)(void *owner, const char *name, int status, const char *category, const char *message, ...);
#define tell(log, owner, name, status, category, message) (log)(owner, name, status, category, "%s", message)
#include "fmi.h"

typedef struct {
    Logger log;
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*finished)(void *, int);
    void *owner;
} Callbacks;

typedef struct {
    int again, terminate, nominals, values, timed;
    double time;
} EventInfo;

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }
ONE(fmi2SetDebugLogging, void *c, int on, size_t n, const char *const *x) { (void)on; (void)n; (void)x; ME(OK); }

EXPORT void *fmi2Instantiate(const char *name, int type, const char *guid, const char *place, const Callbacks *calls,
                             int visible, int logging)
{
    (void)type; (void)place; (void)visible; (void)logging;
    return instance(guid, name, calls ? calls->log : NULL, calls ? calls->owner : NULL);
}
ONE(fmi2SetupExperiment, void *c, int tol, double t, double start, int stop, double end)
{
    (void)tol; (void)t; (void)stop; (void)end;
    ((Model *)c)->value[TIME] = start;
    return OK;
}
ONE(fmi2EnterInitializationMode, void *c) { ME(OK); }

ONE(fmi2GetReal, void *c, const unsigned *vr, size_t n, double *x) { return get_values(c, vr, n, x); }
ONE(fmi2SetReal, void *c, const unsigned *vr, size_t n, const double *x) { return set_values(c, vr, n, x); }
#define NONE(name, type) ONE(name, void *c, const unsigned *vr, size_t n, type *x) { (void)vr; (void)x; ME(n ? ERROR_ : OK); }
NONE(fmi2GetInteger, int)
NONE(fmi2GetBoolean, int)
NONE(fmi2GetString, const char *)
NONE(fmi2SetInteger, const int)
NONE(fmi2SetBoolean, const int)
NONE(fmi2SetString, const char *const)

ONE(fmi2GetDirectionalDerivative, void *c, const unsigned *z, size_t n, const unsigned *v, size_t k, const double *dv, double *dz)
{
    (void)z; (void)n; (void)v; (void)k; (void)dv; (void)dz;
    ME(ERROR_);
}

ONE(fmi2NewDiscreteStates, void *c, EventInfo *info) { memset(info, 0, sizeof *info); ME(OK); }
ONE(fmi2CompletedIntegratorStep, void *c, int fixed, int *event, int *end) { (void)fixed; *event = *end = 0; ME(OK); }

ONE(fmi2DoStep, void *c, double t, double h, int fixed)
{
    (void)fixed;
    ((Model *)c)->value[TIME] = t;
    model_step(c, h);
    return checked(c);
}
ONE(fmi2CancelStep, void *c) { ME(ERROR_); }
ONE(fmi2SetRealInputDerivatives, void *c, const unsigned *vr, size_t n, const int *order, const double *x)
{
    (void)vr; (void)n; (void)order; (void)x;
    ME(ERROR_);
}
ONE(fmi2GetRealOutputDerivatives, void *c, const unsigned *vr, size_t n, const int *order, double *x)
{
    (void)vr; (void)n; (void)order; (void)x;
    ME(ERROR_);
}
#define STATUS(name, type) ONE(name, void *c, int kind, type *x) { (void)kind; (void)x; ME(DISCARD); }
STATUS(fmi2GetStatus, int)
STATUS(fmi2GetRealStatus, double)
STATUS(fmi2GetIntegerStatus, int)
STATUS(fmi2GetBooleanStatus, int)
STATUS(fmi2GetStringStatus, const char *)

/* FMI 2.0, model exchange and co-simulation, over model.h. Numbers and structures are those of the standard's C interface. */
#define DRIVE_ID_DOUBLE
#include "model.h"

#if defined _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
enum { OK, WARNING, DISCARD, ERROR_ };
typedef struct {
    int again, terminate, nominals, values, timed;
    double time;
} EventInfo;

#define ME(...) (void)c; return (__VA_ARGS__)
#define ONE(name, ...) EXPORT int name(__VA_ARGS__)

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }
ONE(fmi2SetDebugLogging, void *c, int on, size_t n, const char *const *x) { (void)on; (void)n; (void)x; ME(OK); }

EXPORT void *fmi2Instantiate(const char *name, int type, const char *guid, const char *place, const void *calls, int visible,
                             int logging)
{
    Model *m = guid && strcmp(guid, TOKEN) == 0 ? malloc(sizeof *m) : NULL;
    (void)name; (void)type; (void)place; (void)calls; (void)visible; (void)logging;
    if (m) {
        model_reset(m);
    }
    return m;
}
EXPORT void fmi2FreeInstance(void *c) { free(c); }
ONE(fmi2SetupExperiment, void *c, int tol, double t, double start, int stop, double end)
{
    (void)tol; (void)t; (void)stop; (void)end;
    ((Model *)c)->value[TIME] = start;
    return OK;
}
ONE(fmi2EnterInitializationMode, void *c) { ME(OK); }
ONE(fmi2ExitInitializationMode, void *c) { model_update(c); return OK; }
ONE(fmi2Terminate, void *c) { ME(OK); }
ONE(fmi2Reset, void *c) { model_reset(c); return OK; }

ONE(fmi2GetReal, void *c, const unsigned *vr, size_t n, double *x)
{
    size_t k;
    model_update(c);
    for (k = 0; k < n; k++) {
        if (vr[k] >= VARIABLES) {
            return ERROR_;
        }
        x[k] = ((Model *)c)->value[vr[k]];
    }
    return OK;
}
ONE(fmi2SetReal, void *c, const unsigned *vr, size_t n, const double *x)
{
    size_t k;
    for (k = 0; k < n; k++) {
        if (!model_set(c, vr[k], x[k])) {
            return ERROR_;
        }
    }
    return OK;
}
#define NONE(name, type) ONE(name, void *c, const unsigned *vr, size_t n, type *x) { (void)vr; (void)x; ME(n ? ERROR_ : OK); }
NONE(fmi2GetInteger, int)
NONE(fmi2GetBoolean, int)
NONE(fmi2GetString, const char *)
NONE(fmi2SetInteger, const int)
NONE(fmi2SetBoolean, const int)
NONE(fmi2SetString, const char *const)

ONE(fmi2GetFMUstate, void *c, void **s)
{
    if (!*s && !(*s = malloc(sizeof(Model)))) {
        return ERROR_;
    }
    memcpy(*s, c, sizeof(Model));
    return OK;
}
ONE(fmi2SetFMUstate, void *c, void *s) { memcpy(c, s, sizeof(Model)); return OK; }
ONE(fmi2FreeFMUstate, void *c, void **s) { free(*s); *s = NULL; ME(OK); }
ONE(fmi2SerializedFMUstateSize, void *c, void *s, size_t *n) { (void)s; *n = sizeof(Model); ME(OK); }
ONE(fmi2SerializeFMUstate, void *c, void *s, char *x, size_t n)
{
    if (n < sizeof(Model)) {
        return ERROR_;
    }
    memcpy(x, s, sizeof(Model));
    ME(OK);
}
ONE(fmi2DeSerializeFMUstate, void *c, const char *x, size_t n, void **s)
{
    if (n != sizeof(Model) || (!*s && !(*s = malloc(n)))) {
        return ERROR_;
    }
    memcpy(*s, x, n);
    ME(OK);
}
ONE(fmi2GetDirectionalDerivative, void *c, const unsigned *z, size_t n, const unsigned *v, size_t k, const double *dv, double *dz)
{
    (void)z; (void)n; (void)v; (void)k; (void)dv; (void)dz;
    ME(ERROR_);
}

ONE(fmi2EnterEventMode, void *c) { ME(OK); }
ONE(fmi2NewDiscreteStates, void *c, EventInfo *info) { memset(info, 0, sizeof *info); ME(OK); }
ONE(fmi2EnterContinuousTimeMode, void *c) { ME(OK); }
ONE(fmi2CompletedIntegratorStep, void *c, int fixed, int *event, int *end) { (void)fixed; *event = *end = 0; ME(OK); }
ONE(fmi2SetTime, void *c, double t) { ((Model *)c)->value[TIME] = t; return OK; }
ONE(fmi2SetContinuousStates, void *c, const double *x, size_t n)
{
    memcpy(((Model *)c)->value + I_D, x, (n < STATES ? n : STATES) * sizeof *x);
    return n == STATES ? OK : ERROR_;
}
ONE(fmi2GetContinuousStates, void *c, double *x, size_t n)
{
    memcpy(x, ((Model *)c)->value + I_D, (n < STATES ? n : STATES) * sizeof *x);
    return n == STATES ? OK : ERROR_;
}
ONE(fmi2GetDerivatives, void *c, double *x, size_t n)
{
    model_update(c);
    memcpy(x, ((Model *)c)->value + DER_I_D, (n < STATES ? n : STATES) * sizeof *x);
    return n == STATES ? OK : ERROR_;
}
ONE(fmi2GetNominalsOfContinuousStates, void *c, double *x, size_t n)
{
    size_t k;
    for (k = 0; k < n; k++) {
        x[k] = k < 2 ? DRIVE_ID_I_MAX : 1;
    }
    ME(OK);
}
ONE(fmi2GetEventIndicators, void *c, double *x, size_t n) { (void)x; ME(n ? ERROR_ : OK); }

ONE(fmi2DoStep, void *c, double t, double h, int fixed)
{
    (void)fixed;
    ((Model *)c)->value[TIME] = t;
    return model_step(c, h) ? OK : ERROR_;
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

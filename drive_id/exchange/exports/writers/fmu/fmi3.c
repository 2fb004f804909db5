/* FMI 3.0, model exchange and co-simulation, over model.h. Numbers and types are those of the standard's C interface. */
#define DRIVE_ID_DOUBLE
#include "model.h"
#include <stdbool.h>

#if defined _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
enum { OK, WARNING, DISCARD, ERROR_ };

#define ME(...) (void)c; return (__VA_ARGS__)
#define ONE(name, ...) EXPORT int name(__VA_ARGS__)
#define VRS void *c, const unsigned *vr, size_t n

static Model *instance(const char *token)
{
    Model *m = token && strcmp(token, TOKEN) == 0 ? malloc(sizeof *m) : NULL;
    if (m) {
        model_reset(m);
    }
    return m;
}
EXPORT const char *fmi3GetVersion(void) { return "3.0"; }
ONE(fmi3SetDebugLogging, void *c, bool on, size_t n, const char *const *x) { (void)on; (void)n; (void)x; ME(OK); }
EXPORT void *fmi3InstantiateModelExchange(const char *name, const char *token, const char *place, bool visible, bool logging,
                                          void *owner, const void *log)
{
    (void)name; (void)place; (void)visible; (void)logging; (void)owner; (void)log;
    return instance(token);
}
EXPORT void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *place, bool visible, bool logging,
                                         bool events, bool early, const unsigned *needed, size_t n, void *owner,
                                         const void *log, const void *update)
{
    (void)name; (void)place; (void)visible; (void)logging; (void)events; (void)early; (void)needed; (void)n; (void)owner;
    (void)log; (void)update;
    return instance(token);
}
EXPORT void *fmi3InstantiateScheduledExecution(const char *name, const char *token, const char *place, bool visible,
                                               bool logging, void *owner, const void *log, const void *clock,
                                               const void *lock, const void *unlock)
{
    (void)name; (void)token; (void)place; (void)visible; (void)logging; (void)owner; (void)log; (void)clock; (void)lock;
    (void)unlock;
    return NULL;
}
EXPORT void fmi3FreeInstance(void *c) { free(c); }
ONE(fmi3EnterInitializationMode, void *c, bool tol, double t, double start, bool stop, double end)
{
    (void)tol; (void)t; (void)stop; (void)end;
    ((Model *)c)->value[TIME] = start;
    return OK;
}
ONE(fmi3ExitInitializationMode, void *c) { model_update(c); return OK; }
ONE(fmi3EnterEventMode, void *c) { ME(OK); }
ONE(fmi3Terminate, void *c) { ME(OK); }
ONE(fmi3Reset, void *c) { model_reset(c); return OK; }
ONE(fmi3EnterConfigurationMode, void *c) { ME(OK); }
ONE(fmi3ExitConfigurationMode, void *c) { ME(OK); }

ONE(fmi3GetFloat64, VRS, double *x, size_t count)
{
    size_t k;
    model_update(c);
    for (k = 0; k < n && k < count; k++) {
        if (vr[k] >= VARIABLES) {
            return ERROR_;
        }
        x[k] = ((Model *)c)->value[vr[k]];
    }
    return n == count ? OK : ERROR_;
}
ONE(fmi3SetFloat64, VRS, const double *x, size_t count)
{
    size_t k;
    for (k = 0; k < n && k < count; k++) {
        if (!model_set(c, vr[k], x[k])) {
            return ERROR_;
        }
    }
    return n == count ? OK : ERROR_;
}
#define NONE(kind, type) \
    ONE(fmi3Get##kind, VRS, type *x, size_t count) { (void)vr; (void)x; (void)count; ME(n ? ERROR_ : OK); } \
    ONE(fmi3Set##kind, VRS, const type *x, size_t count) { (void)vr; (void)x; (void)count; ME(n ? ERROR_ : OK); }
NONE(Float32, float)
NONE(Int8, int8_t)
NONE(UInt8, uint8_t)
NONE(Int16, int16_t)
NONE(UInt16, uint16_t)
NONE(Int32, int32_t)
NONE(UInt32, uint32_t)
NONE(Int64, int64_t)
NONE(UInt64, uint64_t)
NONE(Boolean, bool)
typedef const char *String;
NONE(String, String)
ONE(fmi3GetBinary, VRS, size_t *s, const uint8_t **x, size_t k) { (void)vr; (void)s; (void)x; (void)k; ME(n ? ERROR_ : OK); }
ONE(fmi3SetBinary, VRS, const size_t *s, const uint8_t *const *x, size_t k)
{
    (void)vr; (void)s; (void)x; (void)k;
    ME(n ? ERROR_ : OK);
}
ONE(fmi3GetClock, VRS, bool *x) { (void)vr; (void)x; ME(n ? ERROR_ : OK); }
ONE(fmi3SetClock, VRS, const bool *x) { (void)vr; (void)x; ME(n ? ERROR_ : OK); }

ONE(fmi3GetNumberOfVariableDependencies, void *c, unsigned vr, size_t *n) { (void)vr; *n = 0; ME(ERROR_); }
ONE(fmi3GetVariableDependencies, void *c, unsigned vr, size_t *a, unsigned *b, size_t *d, int *kind, size_t n)
{
    (void)vr; (void)a; (void)b; (void)d; (void)kind; (void)n;
    ME(ERROR_);
}
ONE(fmi3GetFMUState, void *c, void **s)
{
    if (!*s && !(*s = malloc(sizeof(Model)))) {
        return ERROR_;
    }
    memcpy(*s, c, sizeof(Model));
    return OK;
}
ONE(fmi3SetFMUState, void *c, void *s) { memcpy(c, s, sizeof(Model)); return OK; }
ONE(fmi3FreeFMUState, void *c, void **s) { free(*s); *s = NULL; ME(OK); }
ONE(fmi3SerializedFMUStateSize, void *c, void *s, size_t *n) { (void)s; *n = sizeof(Model); ME(OK); }
ONE(fmi3SerializeFMUState, void *c, void *s, uint8_t *x, size_t n)
{
    if (n < sizeof(Model)) {
        return ERROR_;
    }
    memcpy(x, s, sizeof(Model));
    ME(OK);
}
ONE(fmi3DeserializeFMUState, void *c, const uint8_t *x, size_t n, void **s)
{
    if (n != sizeof(Model) || (!*s && !(*s = malloc(n)))) {
        return ERROR_;
    }
    memcpy(*s, x, n);
    ME(OK);
}
#define DERIVATIVE(name) \
    ONE(name, void *c, const unsigned *z, size_t n, const unsigned *v, size_t k, const double *dv, size_t l, double *dz, size_t m) \
    { (void)z; (void)n; (void)v; (void)k; (void)dv; (void)l; (void)dz; (void)m; ME(ERROR_); }
DERIVATIVE(fmi3GetDirectionalDerivative)
DERIVATIVE(fmi3GetAdjointDerivative)

ONE(fmi3GetIntervalDecimal, VRS, double *x, int *q) { (void)vr; (void)n; (void)x; (void)q; ME(ERROR_); }
ONE(fmi3GetIntervalFraction, VRS, uint64_t *x, uint64_t *y, int *q) { (void)vr; (void)n; (void)x; (void)y; (void)q; ME(ERROR_); }
ONE(fmi3GetShiftDecimal, VRS, double *x) { (void)vr; (void)n; (void)x; ME(ERROR_); }
ONE(fmi3GetShiftFraction, VRS, uint64_t *x, uint64_t *y) { (void)vr; (void)n; (void)x; (void)y; ME(ERROR_); }
ONE(fmi3SetIntervalDecimal, VRS, const double *x) { (void)vr; (void)n; (void)x; ME(ERROR_); }
ONE(fmi3SetIntervalFraction, VRS, const uint64_t *x, const uint64_t *y) { (void)vr; (void)n; (void)x; (void)y; ME(ERROR_); }
ONE(fmi3SetShiftDecimal, VRS, const double *x) { (void)vr; (void)n; (void)x; ME(ERROR_); }
ONE(fmi3SetShiftFraction, VRS, const uint64_t *x, const uint64_t *y) { (void)vr; (void)n; (void)x; (void)y; ME(ERROR_); }
ONE(fmi3EvaluateDiscreteStates, void *c) { ME(OK); }
ONE(fmi3UpdateDiscreteStates, void *c, bool *again, bool *end, bool *nominals, bool *values, bool *timed, double *time)
{
    *again = *end = *nominals = *values = *timed = false;
    *time = 0;
    ME(OK);
}

ONE(fmi3EnterContinuousTimeMode, void *c) { ME(OK); }
ONE(fmi3CompletedIntegratorStep, void *c, bool fixed, bool *event, bool *end) { (void)fixed; *event = *end = false; ME(OK); }
ONE(fmi3SetTime, void *c, double t) { ((Model *)c)->value[TIME] = t; return OK; }
ONE(fmi3SetContinuousStates, void *c, const double *x, size_t n)
{
    memcpy(((Model *)c)->value + I_D, x, (n < STATES ? n : STATES) * sizeof *x);
    return n == STATES ? OK : ERROR_;
}
ONE(fmi3GetContinuousStates, void *c, double *x, size_t n)
{
    memcpy(x, ((Model *)c)->value + I_D, (n < STATES ? n : STATES) * sizeof *x);
    return n == STATES ? OK : ERROR_;
}
ONE(fmi3GetContinuousStateDerivatives, void *c, double *x, size_t n)
{
    model_update(c);
    memcpy(x, ((Model *)c)->value + DER_I_D, (n < STATES ? n : STATES) * sizeof *x);
    return n == STATES ? OK : ERROR_;
}
ONE(fmi3GetNominalsOfContinuousStates, void *c, double *x, size_t n)
{
    size_t k;
    for (k = 0; k < n; k++) {
        x[k] = k < 2 ? DRIVE_ID_I_MAX : 1;
    }
    ME(OK);
}
ONE(fmi3GetEventIndicators, void *c, double *x, size_t n) { (void)x; ME(n ? ERROR_ : OK); }
ONE(fmi3GetNumberOfEventIndicators, void *c, size_t *n) { *n = 0; ME(OK); }
ONE(fmi3GetNumberOfContinuousStates, void *c, size_t *n) { *n = STATES; ME(OK); }

ONE(fmi3EnterStepMode, void *c) { ME(OK); }
ONE(fmi3GetOutputDerivatives, VRS, const int *order, double *x, size_t k)
{
    (void)vr; (void)n; (void)order; (void)x; (void)k;
    ME(ERROR_);
}
ONE(fmi3DoStep, void *c, double t, double h, bool fixed, bool *event, bool *end, bool *early, double *last)
{
    (void)fixed;
    *event = *end = *early = false;
    ((Model *)c)->value[TIME] = t;
    *last = t + h;
    return model_step(c, h) ? OK : ERROR_;
}
ONE(fmi3ActivateModelPartition, void *c, unsigned clock, double t) { (void)clock; (void)t; ME(ERROR_); }

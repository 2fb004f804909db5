/* FMI 3.0, model exchange and co-simulation, over model.h. Numbers and types are those of the standard's C interface. */
#define FMI(name) fmi3##name
typedef void (*Logger)(void *owner, int status, const char *category, const char *message);
#define tell(log, owner, name, status, category, message) ((void)(name), (log)(owner, status, category, message))
#include "fmi.h"
#include <stdbool.h>

#define VRS void *c, const unsigned *vr, size_t n

EXPORT const char *fmi3GetVersion(void) { return "3.0"; }
ONE(fmi3SetDebugLogging, void *c, bool on, size_t n, const char *const *x) { (void)on; (void)n; (void)x; ME(OK); }
EXPORT void *fmi3InstantiateModelExchange(const char *name, const char *token, const char *place, bool visible, bool logging,
                                          void *owner, Logger log)
{
    (void)place; (void)visible; (void)logging;
    return instance(token, name, log, owner);
}
EXPORT void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *place, bool visible, bool logging,
                                         bool events, bool early, const unsigned *needed, size_t n, void *owner,
                                         Logger log, const void *update)
{
    (void)place; (void)visible; (void)logging; (void)events; (void)early; (void)needed; (void)n; (void)update;
    return instance(token, name, log, owner);
}
EXPORT void *fmi3InstantiateScheduledExecution(const char *name, const char *token, const char *place, bool visible,
                                               bool logging, void *owner, const void *log, const void *clock,
                                               const void *lock, const void *unlock)
{
    (void)name; (void)token; (void)place; (void)visible; (void)logging; (void)owner; (void)log; (void)clock; (void)lock;
    (void)unlock;
    return NULL;
}
ONE(fmi3EnterInitializationMode, void *c, bool tol, double t, double start, bool stop, double end)
{
    (void)tol; (void)t; (void)stop; (void)end;
    ((Model *)c)->value[TIME] = start;
    return OK;
}
ONE(fmi3EnterConfigurationMode, void *c) { ME(OK); }
ONE(fmi3ExitConfigurationMode, void *c) { ME(OK); }

ONE(fmi3GetFloat64, VRS, double *x, size_t count) { return n == count ? get_values(c, vr, n, x) : ERROR_; }
ONE(fmi3SetFloat64, VRS, const double *x, size_t count) { return n == count ? set_values(c, vr, n, x) : ERROR_; }
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

ONE(fmi3CompletedIntegratorStep, void *c, bool fixed, bool *event, bool *end) { (void)fixed; *event = *end = false; ME(OK); }
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
    model_step(c, h);
    return checked(c);
}
ONE(fmi3ActivateModelPartition, void *c, unsigned clock, double t) { (void)clock; (void)t; ME(ERROR_); }

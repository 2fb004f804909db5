/*
 * What FMI 2.0 and 3.0 have in common, over model.h. A file that includes this defines FMI(name), which puts the prefix of
 * its version before a name of version 3.0, the type Logger, and tell(log, owner, name, status, category, message).
 */
#define DRIVE_ID_DOUBLE
#include "model.h"

#if defined _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
enum { OK, WARNING, DISCARD, ERROR_ };

#define ME(...) (void)c; return (__VA_ARGS__)
#define ONE(name, ...) EXPORT int name(__VA_ARGS__)

/* The model comes first: an instance is one. */
typedef struct {
    Model model;
    int beyond; /* it was told that the current is beyond the map */
    char *name;
    Logger log;
    void *owner;
} Instance;

static Model *instance(const char *token, const char *name, Logger log, void *owner)
{
    Instance *o = token && strcmp(token, TOKEN) == 0 ? calloc(1, sizeof *o) : NULL;
    if (o) {
        model_reset(&o->model);
        o->log = log;
        o->owner = owner;
        o->name = name ? malloc(strlen(name) + 1) : NULL;
        if (o->name) {
            strcpy(o->name, name);
        }
    }
    return (Model *)o;
}

/* Say what is wrong after a step: an error each time, a current beyond the map once until it is back. */
static int checked(void *c)
{
    Instance *o = c;
    const char *trouble = model_trouble(&o->model);
    const int failed = trouble && !(isfinite(o->model.value[I_D]) && isfinite(o->model.value[I_Q]));
    if (trouble && o->log && (failed || !o->beyond)) {
        tell(o->log, o->owner, o->name ? o->name : "drive", failed ? ERROR_ : WARNING, failed ? "logStatusError" : "logStatusWarning",
             trouble);
    }
    o->beyond = trouble && !failed;
    return failed ? ERROR_ : OK;
}
static int get_values(Model *m, const unsigned *vr, size_t n, double *x)
{
    size_t k;
    model_update(m);
    for (k = 0; k < n; k++) {
        if (vr[k] >= VARIABLES) {
            return ERROR_;
        }
        x[k] = m->value[vr[k]];
    }
    return OK;
}
static int set_values(Model *m, const unsigned *vr, size_t n, const double *x)
{
    size_t k;
    for (k = 0; k < n; k++) {
        if (!model_set(m, vr[k], x[k])) {
            return ERROR_;
        }
    }
    return OK;
}
EXPORT void FMI(FreeInstance)(void *c)
{
    if (c) {
        free(((Instance *)c)->name);
    }
    free(c);
}
ONE(FMI(ExitInitializationMode), void *c) { model_update(c); return OK; }
ONE(FMI(Terminate), void *c) { ME(OK); }
ONE(FMI(Reset), void *c) { model_reset(c); return OK; }
ONE(FMI(EnterEventMode), void *c) { ME(OK); }
ONE(FMI(EnterContinuousTimeMode), void *c) { ME(OK); }

ONE(FMI(GetFMUState), void *c, void **s)
{
    if (!*s && !(*s = malloc(sizeof(Model)))) {
        return ERROR_;
    }
    memcpy(*s, c, sizeof(Model));
    return OK;
}
ONE(FMI(SetFMUState), void *c, void *s) { memcpy(c, s, sizeof(Model)); return OK; }
ONE(FMI(FreeFMUState), void *c, void **s) { free(*s); *s = NULL; ME(OK); }
ONE(FMI(SerializedFMUStateSize), void *c, void *s, size_t *n) { (void)s; *n = sizeof(Model); ME(OK); }
ONE(FMI(SerializeFMUState), void *c, void *s, void *x, size_t n)
{
    if (n < sizeof(Model)) {
        return ERROR_;
    }
    memcpy(x, s, sizeof(Model));
    ME(OK);
}
ONE(FMI(DeserializeFMUState), void *c, const void *x, size_t n, void **s)
{
    if (n != sizeof(Model) || (!*s && !(*s = malloc(n)))) {
        return ERROR_;
    }
    memcpy(*s, x, n);
    ME(OK);
}

ONE(FMI(SetTime), void *c, double t) { ((Model *)c)->value[TIME] = t; return OK; }
ONE(FMI(SetContinuousStates), void *c, const double *x, size_t n)
{
    memcpy(((Model *)c)->value + I_D, x, (n < STATES ? n : STATES) * sizeof *x);
    return n == STATES ? checked(c) : ERROR_;
}
ONE(FMI(GetContinuousStates), void *c, double *x, size_t n)
{
    memcpy(x, ((Model *)c)->value + I_D, (n < STATES ? n : STATES) * sizeof *x);
    return n == STATES ? OK : ERROR_;
}
ONE(FMI(GetContinuousStateDerivatives), void *c, double *x, size_t n)
{
    model_update(c);
    memcpy(x, ((Model *)c)->value + DER_I_D, (n < STATES ? n : STATES) * sizeof *x);
    return n == STATES ? OK : ERROR_;
}
ONE(FMI(GetNominalsOfContinuousStates), void *c, double *x, size_t n)
{
    size_t k;
    for (k = 0; k < n; k++) {
        x[k] = k < 2 ? DRIVE_ID_I_MAX : 1;
    }
    ME(OK);
}
ONE(FMI(GetEventIndicators), void *c, double *x, size_t n) { (void)x; ME(n ? ERROR_ : OK); }

"""Functions of FMI 2.0 for co-simulation in C99, around the translated kernel of a twin.

The code includes nothing but the C library. One instance holds all that the kernel remembers; there are no globals, so
any number of instances run side by side. Inputs hold from the start of a communication step to its end, as in a record.
"""

from __future__ import annotations

from collections.abc import Mapping

HEAD = """/* FMI 2.0 co-simulation of a digital twin. Generated; see `documentation/index.html`. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
"""
_INTERFACE = r"""
typedef void *fmi2Component;
typedef double fmi2Real;
typedef int fmi2Integer;
typedef int fmi2Boolean;
typedef const char *fmi2String;
typedef unsigned int fmi2Ref;
typedef char fmi2Byte;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef void (*fmi2Log)(void *, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
typedef struct {
    fmi2Log log;
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*finished)(void *, fmi2Status);
    void *environment;
} fmi2Callbacks;
#ifdef FMI2_FUNCTION_PREFIX
#define JOIN_NAMES(a, b) a##b
#define JOINED(a, b) JOIN_NAMES(a, b)
#define NAMED(name) JOINED(FMI2_FUNCTION_PREFIX, name)
#else
#define NAMED(name) name
#endif
#ifdef _WIN32
#define EXPORTED __declspec(dllexport)
#elif defined(__GNUC__)
#define EXPORTED __attribute__((visibility("default")))
#else
#define EXPORTED
#endif
#define FMI(name) EXPORTED fmi2Status NAMED(fmi2##name)

typedef struct {
    double parameters[PARAMETERS + 1], initial[NODES + 1], inputs[COLUMNS + 1], outputs[READINGS + 1];
    double state[WIDTH], next[WIDTH], past[ROWS + 1], future[ROWS + 1];
    double *times, *columns, *readings; /* earlier changes of the inputs, then two rows for the step under way */
    long earlier, room;
    double now;
    int remembers, started, current;
    fmi2Log log;
    void *environment;
    char *name;
} Twin;

static fmi2Status failed(Twin *t, const char *text) {
    if (t->log) t->log(t->environment, t->name, fmi2Error, "logStatusError", "%s", text);
    return fmi2Error;
}

static void restart(Twin *t) {
    memcpy(t->parameters, start_parameters, sizeof start_parameters);
    memcpy(t->initial, start_temperatures, sizeof start_temperatures);
    memcpy(t->inputs, start_inputs, sizeof start_inputs);
    t->now = 0.0;
    t->earlier = 0;
    t->remembers = t->started = t->current = 0;
}

static void start(Twin *t) {
    long k;
    for (k = 0; k < WIDTH; k++) t->state[k] = k < NODES ? t->initial[k] : NAN;
    t->remembers = 0;
    t->earlier = 0;
    t->started = 1;
}

/* Have room for one more change of the inputs, and for the two rows of a step. */
static int has_room(Twin *t) {
    long wanted = t->earlier + 3, room = t->room ? t->room : 8;
    double *times, *columns, *readings;
    if (wanted <= t->room) return 1;
    while (room < wanted) room *= 2;
    times = realloc(t->times, room * sizeof(double));
    if (times) t->times = times;
    columns = realloc(t->columns, room * (COLUMNS + 1) * sizeof(double));
    if (columns) t->columns = columns;
    readings = realloc(t->readings, room * (READINGS + 1) * sizeof(double));
    if (readings) t->readings = readings;
    if (!times || !columns || !readings) return 0;
    t->room = room;
    return 1;
}

static void put_row(Twin *t, long row, double time) {
    t->times[row] = time;
    memcpy(t->columns + row * COLUMNS, t->inputs, COLUMNS * sizeof(double));
    if (STAMP >= 0) t->columns[row * COLUMNS + STAMP] = time;
}

/* Run the kernel from the present row to the row `stop` - 1. */
static void run(Twin *t, long stop) {
    long first = t->earlier;
    array base = { t->parameters, { PARAMETERS } }, lanes = { NULL, { 1, 0, 1 } };
    array begin = { t->state, { 1, WIDTH, 1 } }, end = { t->next, { 1, WIDTH, 1 } };
    array past = { t->past, { t->remembers, ROWS, 1 } };
    array future = { t->future, { stop > first + 1 && ROWS > 0, ROWS, 1 } };
    array time = { t->times, { stop } }, inputs = { t->columns, { stop, COLUMNS } };
    array readings = { t->readings, { 1, stop, READINGS, 1 } };
    k_piece(base, lanes, begin, past, first, stop, time, inputs, readings, end, future);
}

static fmi2Status observe(Twin *t) {
    if (t->current) return fmi2OK;
    if (!t->started) start(t);
    if (!has_room(t)) return failed(t, "there is no memory left");
    put_row(t, t->earlier, t->now);
    run(t, t->earlier + 1);
    memcpy(t->outputs, t->readings + t->earlier * READINGS, READINGS * sizeof(double));
    t->current = 1;
    return fmi2OK;
}

EXPORTED const char *NAMED(fmi2GetTypesPlatform)(void) { return "default"; }
EXPORTED const char *NAMED(fmi2GetVersion)(void) { return "2.0"; }

FMI(SetDebugLogging)(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String names[]) {
    (void)c; (void)on; (void)n; (void)names;
    return fmi2OK;
}

EXPORTED fmi2Component NAMED(fmi2Instantiate)(fmi2String name, int kind, fmi2String guid, fmi2String resources,
                                              const fmi2Callbacks *callbacks, fmi2Boolean visible,
                                              fmi2Boolean logging) {
    Twin *t = calloc(1, sizeof(Twin));
    (void)resources; (void)visible; (void)logging;
    if (!t) return NULL;
    t->log = callbacks ? callbacks->log : NULL;
    t->environment = callbacks ? callbacks->environment : NULL;
    t->name = calloc(1, strlen(name ? name : "") + 1);
    if (t->name) strcpy(t->name, name ? name : "");
    if (!t->name || kind != 1 || !guid || strcmp(guid, GUID)) {
        failed(t, kind != 1 ? "this FMU is for co-simulation" : "the GUID is not that of modelDescription.xml");
        free(t->name);
        free(t);
        return NULL;
    }
    restart(t);
    return t;
}

EXPORTED void NAMED(fmi2FreeInstance)(fmi2Component c) {
    Twin *t = c;
    if (!t) return;
    free(t->times);
    free(t->columns);
    free(t->readings);
    free(t->name);
    free(t);
}

FMI(SetupExperiment)(fmi2Component c, fmi2Boolean tolerant, double tolerance, double begin, fmi2Boolean ends,
                     double end) {
    (void)tolerant; (void)tolerance; (void)ends; (void)end;
    ((Twin *)c)->now = begin;
    return fmi2OK;
}

FMI(EnterInitializationMode)(fmi2Component c) { (void)c; return fmi2OK; }
FMI(ExitInitializationMode)(fmi2Component c) { start(c); ((Twin *)c)->current = 0; return fmi2OK; }
FMI(Terminate)(fmi2Component c) { (void)c; return fmi2OK; }
FMI(Reset)(fmi2Component c) { restart(c); return fmi2OK; }

/* References: inputs, then outputs, then tunable parameters, then initial temperatures. */
FMI(GetReal)(fmi2Component c, const fmi2Ref refs[], size_t n, double values[]) {
    Twin *t = c;
    size_t k;
    for (k = 0; k < n; k++) {
        long r = refs[k];
        if (r < INPUTS) values[k] = t->inputs[input_columns[r]];
        else if ((r -= INPUTS) < READINGS) {
            if (observe(t) != fmi2OK) return fmi2Error;
            values[k] = t->outputs[r];
        }
        else if ((r -= READINGS) < TUNABLES) values[k] = t->parameters[tunable_parameters[r]];
        else if ((r -= TUNABLES) < NODES) values[k] = t->initial[r];
        else return failed(t, "there is no variable of this reference");
    }
    return fmi2OK;
}

FMI(SetReal)(fmi2Component c, const fmi2Ref refs[], size_t n, const double values[]) {
    Twin *t = c;
    size_t k;
    for (k = 0; k < n; k++) {
        long r = refs[k];
        if (r < INPUTS) {
            /* As in a record: a value that is missing holds the last good one. */
            if (isfinite(values[k])) t->inputs[input_columns[r]] = values[k];
        }
        else if (!isfinite(values[k])) return failed(t, "a parameter must be finite");
        else if ((r -= INPUTS + READINGS) >= 0 && r < TUNABLES) t->parameters[tunable_parameters[r]] = values[k];
        else if (r >= TUNABLES && r < TUNABLES + NODES) { t->initial[r - TUNABLES] = values[k]; t->started = 0; }
        else return failed(t, "this variable cannot be set");
    }
    t->current = 0;
    return fmi2OK;
}

/* Return 1 if two rows of inputs differ otherwise than by their stamps. */
static int differs(const double *row, const double *before) {
    long c;
    for (c = 0; c < COLUMNS; c++) if (c != STAMP && row[c] != before[c]) return 1;
    return 0;
}

FMI(DoStep)(fmi2Component c, double at, double step, fmi2Boolean no_return) {
    Twin *t = c;
    long k, row;
    (void)no_return;
    if (!(step >= 0.0) || !isfinite(at) || !isfinite(step)) return failed(t, "a step must be finite and not negative");
    if (!t->started) start(t);
    if (!has_room(t)) return failed(t, "there is no memory left");
    row = t->earlier;
    put_row(t, row, at);
    put_row(t, row + 1, at + step);
    run(t, row + 2);
    for (k = 0; k < WIDTH; k++) if (!isfinite(t->next[k])) return failed(t, "a temperature is not finite any more");
    memcpy(t->state, t->next, sizeof t->state);
    memcpy(t->past, t->future, sizeof t->past);
    t->remembers = ROWS > 0;
    t->now = at + step;
    t->current = 0;
    if (LOOKS_BACK && (row == 0 || differs(t->columns + row * COLUMNS, t->columns + (row - 1) * COLUMNS))) t->earlier++;
    return fmi2OK;
}

FMI(CancelStep)(fmi2Component c) { return failed(c, "steps are not asynchronous"); }
#define WITHOUT(name, type) \
    FMI(name)(fmi2Component c, const fmi2Ref refs[], size_t n, type values[]) { \
        (void)refs; (void)values; \
        return n ? failed(c, "all variables are real numbers") : fmi2OK; \
    }
WITHOUT(GetInteger, fmi2Integer)
WITHOUT(GetBoolean, fmi2Boolean)
WITHOUT(GetString, fmi2String)
WITHOUT(SetInteger, const fmi2Integer)
WITHOUT(SetBoolean, const fmi2Boolean)
WITHOUT(SetString, const fmi2String)
#define NO_STATUS(name, type) \
    FMI(name)(fmi2Component c, int kind, type *value) { (void)c; (void)kind; (void)value; return fmi2Discard; }
NO_STATUS(GetStatus, fmi2Status)
NO_STATUS(GetIntegerStatus, fmi2Integer)
NO_STATUS(GetBooleanStatus, fmi2Boolean)
NO_STATUS(GetStringStatus, fmi2String)
FMI(GetRealStatus)(fmi2Component c, int kind, double *value) {
    if (kind != 2) return fmi2Discard; /* fmi2LastSuccessfulTime */
    *value = ((Twin *)c)->now;
    return fmi2OK;
}
static fmi2Status no_state(fmi2Component c) { return failed(c, "states are not handed out"); }
FMI(GetFMUstate)(fmi2Component c, void **state) { (void)state; return no_state(c); }
FMI(SetFMUstate)(fmi2Component c, void *state) { (void)state; return no_state(c); }
FMI(FreeFMUstate)(fmi2Component c, void **state) { (void)c; (void)state; return fmi2OK; }
FMI(SerializedFMUstateSize)(fmi2Component c, void *s, size_t *n) { (void)s; (void)n; return no_state(c); }
FMI(SerializeFMUstate)(fmi2Component c, void *s, fmi2Byte b[], size_t n) {
    (void)s; (void)b; (void)n;
    return no_state(c);
}
FMI(DeSerializeFMUstate)(fmi2Component c, const fmi2Byte b[], size_t n, void **s) {
    (void)b; (void)n; (void)s;
    return no_state(c);
}
FMI(GetDirectionalDerivative)(fmi2Component c, const fmi2Ref u[], size_t n, const fmi2Ref k[], size_t m,
                              const double d[], double v[]) {
    (void)u; (void)n; (void)k; (void)m; (void)d; (void)v;
    return failed(c, "there are no derivatives");
}
FMI(SetRealInputDerivatives)(fmi2Component c, const fmi2Ref r[], size_t n, const int o[], const double v[]) {
    (void)r; (void)n; (void)o; (void)v;
    return failed(c, "inputs are held from step to step");
}
FMI(GetRealOutputDerivatives)(fmi2Component c, const fmi2Ref r[], size_t n, const int o[], double v[]) {
    (void)r; (void)n; (void)o; (void)v;
    return failed(c, "there are no derivatives");
}
"""


def interface_source(kernel: str, numbers: Mapping[str, int], tables: Mapping[str, list[float]], guid: str) -> str:
    """Return the whole C code of an FMU.

    Parameters
    ----------
    kernel
        Code of the kernel, as `twin.kernel.c_source` gives it.
    numbers
        Sizes by name: PARAMETERS, NODES, COLUMNS, INPUTS, READINGS, TUNABLES, WIDTH, ROWS, STAMP, LOOKS_BACK.
    tables
        Start values and indices by name; those whose name ends in `columns` or `parameters` of integers are indices.
    guid
        Identity of the FMU, as in its description.
    """
    lines = [f"#define {name} {value}" for name, value in numbers.items()] + [f'#define GUID "{guid}"']
    for name, values in tables.items():
        indices = all(isinstance(value, int) for value in values)
        numbers_text = ", ".join(repr(value) for value in values) or "0"
        lines.append(f"static const {'int' if indices else 'double'} {name}[] = {{ {numbers_text} }};")
    return "\n".join([HEAD, kernel, *lines, _INTERFACE])

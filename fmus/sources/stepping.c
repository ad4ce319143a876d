/* The stepping loop of a co-simulation, of any FMU of FMI 2.0 or 3.0: input, step, outputs, row by row.
 *
 * It does what fmus/cosimulation.py does where nothing happens, and asks it (`trouble`) wherever something does: a status other than OK,
 * a step that ends early, an event. `Loop` and `Group` are described once more in fmus/compiled.py.
 */
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#if defined _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

typedef int (*Access2)(void *instance, const uint32_t *references, size_t count, void *values);
typedef int (*Access3)(void *instance, const uint32_t *references, size_t count, void *values, size_t size);
typedef int (*Tilt2)(void *instance, const uint32_t *references, size_t count, const int *orders, const double *values);
typedef int (*Step2)(void *instance, double time, double size, int no_going_back);
typedef int (*Step3)(void *instance, double time, double size, bool no_going_back, bool *event, bool *terminate, bool *early, double *reached);

/* What `trouble` is asked about; READ and what follows is the reading of a group. */
enum { INPUT, SET, TILT, PART, STEP, READ };

/* Numbers as FMI has them. */
enum { FLOAT64, FLOAT32, INT8, INT16, INT32, INT64, UINT8, UINT16, UINT32, UINT64, BOOLEAN };

/* The variables of one type, read by one call. Column `columns[k]` of a row is number `places[k]` of what is read. */
typedef struct {
    void *get;
    const uint32_t *references;
    void *buffer; /* of `size` numbers; NULL: they are a row as they come */
    const size_t *columns, *places;
    size_t reference_count, size, count;
    int kind;
} Group;

typedef struct {
    void *instance, *step, *set, *tilt; /* `tilt`: NULL if slopes are not told */
    const uint32_t *input;
    void *box; /* what `set` sets: `box_size` numbers, of which number `place` is driven */
    bool *event, *terminate, *early;
    double *reached;
    const double *times, *sizes, *levels, *slopes; /* `slopes` may be NULL */
    double *rows;
    volatile int64_t *count; /* of complete rows; others watch it */
    const Group *groups;
    int (*trouble)(size_t row, int what, int status); /* nonzero: the end */
    size_t box_size, place, points, width, group_count;
    double event_time; /* the next event that the FMU has announced */
    int version, single, events, divisible; /* 2 or 3; a float32 input; event mode; steps may be cut */
} Loop;

static int access(const Loop *l, void *function, const uint32_t *references, size_t count, void *values, size_t size) {
    if (l->version == 2) return ((Access2)function)(l->instance, references, count, values);
    return ((Access3)function)(l->instance, references, count, values, size);
}

static double number(const Group *g, size_t place) {
    switch (g->kind) {
    case FLOAT32: return ((const float *)g->buffer)[place];
    case INT8: return ((const int8_t *)g->buffer)[place];
    case INT16: return ((const int16_t *)g->buffer)[place];
    case INT32: return ((const int32_t *)g->buffer)[place];
    case INT64: return (double)((const int64_t *)g->buffer)[place];
    case UINT8: return ((const uint8_t *)g->buffer)[place];
    case UINT16: return ((const uint16_t *)g->buffer)[place];
    case UINT32: return ((const uint32_t *)g->buffer)[place];
    case UINT64: return (double)((const uint64_t *)g->buffer)[place];
    case BOOLEAN: return ((const bool *)g->buffer)[place];
    default: return ((const double *)g->buffer)[place];
    }
}

static int tell(const Loop *l, size_t i, double level, double slope) {
    if (l->events) return l->trouble(i, INPUT, 0); /* a jump of the input is an event */
    if (l->single) ((float *)l->box)[l->place] = (float)level;
    else ((double *)l->box)[l->place] = level;
    int status = access(l, l->set, l->input, 1, l->box, l->box_size);
    if (status && l->trouble(i, SET, status)) return 1;
    if (l->tilt) {
        const int first = 1;
        status = ((Tilt2)l->tilt)(l->instance, l->input, 1, &first, &slope);
        if (status && l->trouble(i, TILT, status)) return 1;
    }
    return 0;
}

static int advance(const Loop *l, size_t i) {
    const double time = l->times[i], size = l->sizes[i];
    if (l->divisible && l->event_time < time + size) return l->trouble(i, PART, 0);
    if (l->version == 2) {
        const int status = ((Step2)l->step)(l->instance, time, size, 1);
        return status ? l->trouble(i, STEP, status) : 0;
    }
    const int status = ((Step3)l->step)(l->instance, time, size, true, l->event, l->terminate, l->early, l->reached);
    return status || *l->event || *l->terminate || *l->early ? l->trouble(i, STEP, status) : 0;
}

static int read(const Loop *l, size_t row) {
    double *cells = l->rows + row * l->width;
    for (size_t j = 0; j < l->group_count; j++) {
        const Group *g = &l->groups[j];
        const int status = access(l, g->get, g->references, g->reference_count, g->buffer ? g->buffer : cells, g->size);
        if (status && l->trouble(row, READ + (int)j, status)) return 1;
        for (size_t k = 0; g->buffer && k < g->count; k++) cells[g->columns[k]] = number(g, g->places[k]);
    }
    return 0;
}

/* All steps, the first row being there already; 0, or 1 if `trouble` has ended it. */
EXPORT int slewcert_steps(const Loop *l) {
    double applied = NAN, sloped = 0.0;
    for (size_t i = 0; i + 1 < l->points; i++) {
        const double level = l->levels[i], slope = l->slopes ? l->slopes[i] : 0.0;
        if (level != applied || slope != 0.0 || sloped != 0.0) {
            if (tell(l, i, level, slope)) return 1;
            applied = level, sloped = slope;
        }
        if (advance(l, i) || read(l, i + 1)) return 1;
        *l->count = (int64_t)i + 2;
    }
    return 0;
}

/* So that the two descriptions of what is handed over cannot differ unnoticed. */
EXPORT size_t slewcert_sizes(size_t *group) {
    *group = sizeof(Group);
    return sizeof(Loop);
}

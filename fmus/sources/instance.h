/* An instance of a plant as both FMI versions see it; fmi2.c and fmi3.c only translate. */
#ifndef INSTANCE_H
#define INSTANCE_H

#include "integrator.h"

#include <stddef.h>

typedef enum { CREATED, INITIALIZING, EVENTS, CONTINUOUS, STEPPING, TERMINATED } Phase;

/* Everything that an FMU state holds: plain data, so that copying and serialising it is one memcpy. */
typedef struct {
    Phase phase;
    int outdated; /* derivatives and outputs do not belong to the values beside them */
    int stop_defined;
    int terminate; /* the plant asks for the end of the simulation */
    int event;     /* the last step ended where something happens that event mode is for */
    double stop;
    InputDerivatives input_derivatives;
    Plant plant;
} State;

typedef struct Instance Instance;
typedef void Logger(const Instance *instance, PlantStatus status, const char *message);

struct Instance {
    State state;
    int model_exchange;
    int event_mode;   /* co-simulation with event mode */
    int early_return; /* a step may end at an event */
    int logging;
    char *name;
    void *environment; /* of the importer; only passed back */
    InputSource source;
    void (*update)(void); /* the importer's function for intermediate updates, which `source` may call */
    void (*log)(void); /* the importer's log function, as the version at hand declares it */
    Logger *logger;
};

/* All of these return PLANT_OK, or PLANT_ERROR after a message that names what was wrong. */
PlantStatus report(const Instance *c, PlantStatus status, const char *format, ...);

Instance *create(const char *name, int model_exchange, void *environment, void (*log)(void), Logger *logger);
void destroy(Instance *c);
PlantStatus check_token(const Instance *c, const char *token);
PlantStatus reset(Instance *c);
PlantStatus set_experiment(Instance *c, double start, int stop_defined, double stop);
PlantStatus require(const Instance *c, const char *call, unsigned phases);
PlantStatus enter(Instance *c, const char *call, unsigned from, Phase to);

#define IN(phase) (1u << (phase))
#define IN_ANY 0x1fu /* all but TERMINATED */

typedef enum { REAL, BOOLEAN } Type; /* of the variables that a call is for; Booleans are 0.0 and 1.0 here */

PlantStatus get_values(Instance *c, Type type, const unsigned references[], size_t count, double values[]);
PlantStatus set_values(Instance *c, Type type, const unsigned references[], size_t count, const double values[]);
PlantStatus set_input_derivative(Instance *c, unsigned reference, int order, double value);
PlantStatus set_time(Instance *c, double time);
PlantStatus get_states(Instance *c, double values[], size_t count);
PlantStatus set_states(Instance *c, const double values[], size_t count);
PlantStatus get_derivatives(Instance *c, double values[], size_t count);
PlantStatus complete_step(Instance *c, const char *call, int *terminate);
PlantStatus get_nominals(const Instance *c, double values[], size_t count);
PlantStatus directional(Instance *c, const unsigned unknowns[], size_t n_unknowns, const unsigned knowns[], size_t n_knowns,
                        const double seed[], double sensitivity[]);
PlantStatus adjoint(Instance *c, const unsigned unknowns[], size_t n_unknowns, const unsigned knowns[], size_t n_knowns,
                    const double seed[], double sensitivity[]);

/* May also return PLANT_WARNING, PLANT_DISCARD, PLANT_FATAL or PLANT_TERMINATE (the step was done; the plant wants no other). */
PlantStatus do_step(Instance *c, double time, double step);

/* What happens at this instant has happened; `next` is when the next event is due, INFINITY if none is known. */
PlantStatus update_discrete(Instance *c, const char *call, double *next);

PlantStatus save_state(const Instance *c, void **state);
PlantStatus restore_state(Instance *c, const void *state);
void free_state(void **state);
size_t serialized_size(void);
PlantStatus serialize(const Instance *c, const void *state, unsigned char bytes[], size_t size);
PlantStatus deserialize(const Instance *c, const unsigned char bytes[], size_t size, void **state);

#endif

/* Copies of an instance's state: in memory, and as bytes that another instance of the same binary can read. */
#include "instance.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* The token is the hash of the sources, so bytes of another model or another build of it are told apart. */
typedef struct {
    char token[sizeof PLANT_TOKEN];
    State state;
} Record;

PlantStatus save_state(const Instance *c, void **state) {
    if (!*state)
        *state = malloc(sizeof(State)); /* else the earlier copy is overwritten, as FMI allows */
    if (!*state)
        return report(c, PLANT_ERROR, "no memory for a copy of the state");
    memcpy(*state, &c->state, sizeof(State));
    return PLANT_OK;
}

PlantStatus restore_state(Instance *c, const void *state) {
    if (!state)
        return report(c, PLANT_ERROR, "there is no state to restore");
    memcpy(&c->state, state, sizeof(State));
    return PLANT_OK;
}

void free_state(void **state) {
    if (state) {
        free(*state);
        *state = NULL;
    }
}

size_t serialized_size(void) { return sizeof(Record); }

PlantStatus serialize(const Instance *c, const void *state, unsigned char bytes[], size_t size) {
    if (!state || size < sizeof(Record))
        return report(c, PLANT_ERROR, "a state needs %zu bytes, not %zu", sizeof(Record), size);
    Record record = {.token = PLANT_TOKEN};
    memcpy(&record.state, state, sizeof(State));
    memcpy(bytes, &record, sizeof(Record));
    return PLANT_OK;
}

PlantStatus deserialize(const Instance *c, const unsigned char bytes[], size_t size, void **state) {
    Record record;
    if (size < sizeof(Record))
        return report(c, PLANT_ERROR, "a state has %zu bytes, not %zu", sizeof(Record), size);
    memcpy(&record, bytes, sizeof(Record));
    if (memcmp(record.token, PLANT_TOKEN, sizeof record.token) != 0)
        return report(c, PLANT_ERROR, "these bytes are no state of this model");
    if ((unsigned)record.state.phase > TERMINATED)
        return report(c, PLANT_ERROR, "these bytes are no valid state");
    if (!*state)
        *state = malloc(sizeof(State));
    if (!*state)
        return report(c, PLANT_ERROR, "no memory for a copy of the state");
    memcpy(*state, &record.state, sizeof(State));
    return PLANT_OK;
}

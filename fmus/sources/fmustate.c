/* Copies of an instance's state: in memory, and as bytes that another instance of the same binary can read. */
#include "instance.h"

#include <stdlib.h>
#include <string.h>

/* As bytes: the token, then the state. The token is the hash of the sources, so bytes of another model or build are told apart. */
#define TOKEN_SIZE sizeof PLANT_TOKEN
#define RECORD_SIZE (TOKEN_SIZE + sizeof(State))

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

size_t serialized_size(void) { return RECORD_SIZE; }

PlantStatus serialize(const Instance *c, const void *state, unsigned char bytes[], size_t size) {
    if (!state || size < RECORD_SIZE)
        return report(c, PLANT_ERROR, "a state needs %zu bytes, not %zu", RECORD_SIZE, size);
    memcpy(bytes, PLANT_TOKEN, TOKEN_SIZE);
    memcpy(bytes + TOKEN_SIZE, state, sizeof(State));
    return PLANT_OK;
}

PlantStatus deserialize(const Instance *c, const unsigned char bytes[], size_t size, void **state) {
    Phase phase;
    if (size < RECORD_SIZE)
        return report(c, PLANT_ERROR, "a state has %zu bytes, not %zu", RECORD_SIZE, size);
    if (memcmp(bytes, PLANT_TOKEN, TOKEN_SIZE) != 0)
        return report(c, PLANT_ERROR, "these bytes are no state of this model");
    memcpy(&phase, bytes + TOKEN_SIZE + offsetof(State, phase), sizeof phase);
    if ((unsigned)phase > TERMINATED)
        return report(c, PLANT_ERROR, "these bytes are no valid state");
    if (!*state)
        *state = malloc(sizeof(State));
    if (!*state)
        return report(c, PLANT_ERROR, "no memory for a copy of the state");
    memcpy(*state, bytes + TOKEN_SIZE, sizeof(State));
    return PLANT_OK;
}

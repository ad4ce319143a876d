/* A chain of equal masses on a frictionless rail, joined by equal springs and dampers; a force acts on the first. See README.md. */
#include "plant.h"

/* The pull of spring i, from mass i to mass i + 1, on mass i; there is none beyond the ends. */
static double pull(double stiffness, double damping, const double position[], const double velocity[], int i) {
    if (i < 0 || i >= MASSES - 1)
        return 0.0;
    return stiffness * (position[i + 1] - position[i]) + damping * (velocity[i + 1] - velocity[i]);
}

void plant_derivatives(Plant *p) {
    for (int i = 0; i < MASSES; i++) {
        const double right = pull(p->stiffness, p->damping, p->position, p->velocity, i);
        const double left = pull(p->stiffness, p->damping, p->position, p->velocity, i - 1);
        p->der_position[i] = p->velocity[i];
        p->der_velocity[i] = ((i == 0 ? p->force : 0.0) + right - left) / p->mass;
    }
}

void plant_outputs(Plant *p) {
    double sum = 0.0;
    for (int i = 0; i < MASSES; i++)
        sum += p->position[i];
    p->last = p->position[MASSES - 1];
    p->centre = sum / MASSES;
}

void plant_tangent(const Plant *p, Plant *d) {
    double sum = 0.0;
    for (int i = 0; i < MASSES; i++) {
        /* The state moves, or a parameter does. */
        const double right = pull(p->stiffness, p->damping, d->position, d->velocity, i)
                             + pull(d->stiffness, d->damping, p->position, p->velocity, i);
        const double left = pull(p->stiffness, p->damping, d->position, d->velocity, i - 1)
                            + pull(d->stiffness, d->damping, p->position, p->velocity, i - 1);
        d->der_position[i] = d->velocity[i];
        d->der_velocity[i] = ((i == 0 ? d->force : 0.0) + right - left - p->der_velocity[i] * d->mass) / p->mass;
        sum += d->position[i];
    }
    d->last = d->position[MASSES - 1];
    d->centre = sum / MASSES;
}

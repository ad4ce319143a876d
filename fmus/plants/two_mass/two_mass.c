/* Two masses joined by a spring and a damper on a frictionless rail; a force acts on the first. See README.md. */
#include "plant.h"

void plant_derivatives(Plant *p) {
    const double pull = p->stiffness * (p->position_2 - p->position_1) + p->damping * (p->velocity_2 - p->velocity_1);
    p->der_position_1 = p->velocity_1;
    p->der_velocity_1 = (p->force + pull) / p->mass_1;
    p->der_position_2 = p->velocity_2;
    p->der_velocity_2 = -pull / p->mass_2;
}

void plant_outputs(Plant *p) { p->spring = p->position_2 - p->position_1; }

void plant_tangent(const Plant *p, Plant *d) {
    const double stretch = p->position_2 - p->position_1;
    const double stretching = p->velocity_2 - p->velocity_1;
    const double d_stretch = d->position_2 - d->position_1;
    const double d_pull = p->stiffness * d_stretch + p->damping * (d->velocity_2 - d->velocity_1) /* the state moves … */
                          + d->stiffness * stretch + d->damping * stretching;                     /* … or a parameter does */
    d->der_position_1 = d->velocity_1;
    d->der_velocity_1 = (d->force + d_pull - p->der_velocity_1 * d->mass_1) / p->mass_1;
    d->der_position_2 = d->velocity_2;
    d->der_velocity_2 = (-d_pull - p->der_velocity_2 * d->mass_2) / p->mass_2;
    d->spring = d_stretch;
}

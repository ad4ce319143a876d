/* The arm of a disk drive: amplifier, voice coil, flexible arm with the head at its end. See README.md. */
#include "plant.h"

void plant_derivatives(Plant *p) {
    const double bending = p->stiffness * (p->head_angle - p->coil_angle) + p->damping * (p->head_rate - p->coil_rate);
    p->der_current = (p->amplifier_gain * p->voltage - p->current) / p->amplifier_lag;
    p->der_coil_angle = p->coil_rate;
    p->der_coil_rate = (p->torque_constant * p->current + bending) / p->coil_inertia;
    p->der_head_angle = p->head_rate;
    p->der_head_rate = -bending / p->head_inertia;
}

void plant_outputs(Plant *p) {
    p->head = p->arm_length * p->head_angle;
    p->bend = p->arm_length * (p->head_angle - p->coil_angle);
}

void plant_tangent(const Plant *p, Plant *d) {
    const double angle = p->head_angle - p->coil_angle, rate = p->head_rate - p->coil_rate;
    const double d_angle = d->head_angle - d->coil_angle, d_rate = d->head_rate - d->coil_rate;
    const double d_bending = p->stiffness * d_angle + p->damping * d_rate + d->stiffness * angle + d->damping * rate;
    d->der_current = (p->amplifier_gain * d->voltage + d->amplifier_gain * p->voltage - d->current - p->der_current * d->amplifier_lag)
                     / p->amplifier_lag;
    d->der_coil_angle = d->coil_rate;
    d->der_coil_rate = (p->torque_constant * d->current + d->torque_constant * p->current + d_bending - p->der_coil_rate * d->coil_inertia)
                       / p->coil_inertia;
    d->der_head_angle = d->head_rate;
    d->der_head_rate = (-d_bending - p->der_head_rate * d->head_inertia) / p->head_inertia;
    d->head = p->arm_length * d->head_angle + d->arm_length * p->head_angle;
    d->bend = p->arm_length * d_angle + d->arm_length * angle;
}

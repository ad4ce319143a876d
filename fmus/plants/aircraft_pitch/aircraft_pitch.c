/* The pitch of an aircraft under proportional feedback to its elevator. See README.md. */
#include "plant.h"

static double elevator(double gain, double reference, double pitch) { return gain * (reference - pitch); }

void plant_derivatives(Plant *p) {
    const double deflection = elevator(p->gain, p->reference, p->pitch);
    const double acceleration = p->airframe + p->elevator_moment * deflection;
    p->der_pitch = p->pitch_rate;
    p->der_pitch_rate = acceleration;
    p->der_airframe = p->elevator_lift * deflection - p->pitch_damping * acceleration - p->pitch_stiffness * p->pitch_rate;
}

void plant_outputs(Plant *p) { p->elevator = elevator(p->gain, p->reference, p->pitch); }

void plant_tangent(const Plant *p, Plant *d) {
    const double deflection = elevator(p->gain, p->reference, p->pitch);
    const double d_deflection = elevator(p->gain, d->reference, d->pitch) + elevator(d->gain, p->reference, p->pitch);
    const double d_acceleration = d->airframe + p->elevator_moment * d_deflection + d->elevator_moment * deflection;
    d->der_pitch = d->pitch_rate;
    d->der_pitch_rate = d_acceleration;
    d->der_airframe = p->elevator_lift * d_deflection + d->elevator_lift * deflection
                      - p->pitch_damping * d_acceleration - d->pitch_damping * p->der_pitch_rate
                      - p->pitch_stiffness * d->pitch_rate - d->pitch_stiffness * p->pitch_rate;
    d->elevator = d_deflection;
}

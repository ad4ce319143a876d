/* A spacecraft with two flexible modes, turned by thrusters that are on or off. See README.md. */
#include "plant.h"

#include <math.h>

static const double STANDARD_GRAVITY = 9.80665; /* m/s² */

/* The acceleration with which a mode returns to rest, by stiffness and damping. */
static double restoring(double frequency, double damping_ratio, double deflection, double rate) {
    return 2.0 * damping_ratio * frequency * rate + frequency * frequency * deflection;
}

static double d_restoring(const Plant *p, const Plant *d, double frequency, double d_frequency, double deflection, double d_deflection,
                          double rate, double d_rate) {
    return restoring(frequency, p->damping_ratio, d_deflection, d_rate) + 2.0 * d->damping_ratio * frequency * rate
           + d_frequency * (2.0 * p->damping_ratio * rate + 2.0 * frequency * deflection);
}

void plant_derivatives(Plant *p) {
    const double pull_1 = restoring(p->frequency_1, p->damping_ratio, p->deflection_1, p->deflection_rate_1);
    const double pull_2 = restoring(p->frequency_2, p->damping_ratio, p->deflection_2, p->deflection_rate_2);
    const double rigid = 1.0 - p->coupling_1 * p->coupling_1 - p->coupling_2 * p->coupling_2; /* share of the inertia that does not bend */
    const double acceleration = (p->torque / p->inertia + p->coupling_1 * pull_1 + p->coupling_2 * pull_2) / rigid;
    p->der_angle = p->rate;
    p->der_rate = acceleration;
    p->der_deflection_1 = p->deflection_rate_1;
    p->der_deflection_rate_1 = -pull_1 - p->coupling_1 * acceleration;
    p->der_deflection_2 = p->deflection_rate_2;
    p->der_deflection_rate_2 = -pull_2 - p->coupling_2 * acceleration;
    p->der_propellant = fabs(p->torque) / (p->lever * p->specific_impulse * STANDARD_GRAVITY);
}

void plant_outputs(Plant *p) {
    p->momentum = p->inertia * (p->rate + p->coupling_1 * p->deflection_rate_1 + p->coupling_2 * p->deflection_rate_2);
}

void plant_tangent(const Plant *p, Plant *d) {
    const double c_1 = p->coupling_1, c_2 = p->coupling_2, acceleration = p->der_rate;
    const double pull_1 = restoring(p->frequency_1, p->damping_ratio, p->deflection_1, p->deflection_rate_1);
    const double pull_2 = restoring(p->frequency_2, p->damping_ratio, p->deflection_2, p->deflection_rate_2);
    const double d_pull_1 = d_restoring(p, d, p->frequency_1, d->frequency_1, p->deflection_1, d->deflection_1,
                                        p->deflection_rate_1, d->deflection_rate_1);
    const double d_pull_2 = d_restoring(p, d, p->frequency_2, d->frequency_2, p->deflection_2, d->deflection_2,
                                        p->deflection_rate_2, d->deflection_rate_2);
    const double rigid = 1.0 - c_1 * c_1 - c_2 * c_2, d_rigid = -2.0 * c_1 * d->coupling_1 - 2.0 * c_2 * d->coupling_2;
    const double d_torque = (d->torque - p->torque / p->inertia * d->inertia) / p->inertia;
    const double d_acceleration = (d_torque + c_1 * d_pull_1 + d->coupling_1 * pull_1 + c_2 * d_pull_2 + d->coupling_2 * pull_2
                                   - acceleration * d_rigid) / rigid;
    const double firing = (p->torque > 0.0) - (p->torque < 0.0); /* at rest neither way: the thrusters are off */
    d->der_angle = d->rate;
    d->der_rate = d_acceleration;
    d->der_deflection_1 = d->deflection_rate_1;
    d->der_deflection_rate_1 = -d_pull_1 - c_1 * d_acceleration - d->coupling_1 * acceleration;
    d->der_deflection_2 = d->deflection_rate_2;
    d->der_deflection_rate_2 = -d_pull_2 - c_2 * d_acceleration - d->coupling_2 * acceleration;
    d->der_propellant = firing * d->torque / (p->lever * p->specific_impulse * STANDARD_GRAVITY)
                        - p->der_propellant * (d->lever / p->lever + d->specific_impulse / p->specific_impulse);
    d->momentum = p->inertia * (d->rate + c_1 * d->deflection_rate_1 + d->coupling_1 * p->deflection_rate_1
                                + c_2 * d->deflection_rate_2 + d->coupling_2 * p->deflection_rate_2)
                  + p->momentum / p->inertia * d->inertia;
}

PlantStatus plant_before_step(Plant *p, double step, const char **message) {
    (void)step;
    const double torque = fabs(p->torque), level = fabs(p->thruster_torque);
    if (torque == 0.0 || fabs(torque - level) <= 1e-9 * level)
        return PLANT_OK;
    *message = "thrusters are on or off: torque must be thruster_torque, 0 or -thruster_torque";
    return PLANT_ERROR;
}

/* A gantry crane in a plane: trolley, cable that can be hoisted, load. See README.md. */
#include "plant.h"

#include <math.h>

static const double GRAVITY = 9.80665; /* m/s² */

/* What the load feels along the cable but for the trolley's motion: tension for each kilogram. */
static double hanging(const Plant *p) {
    return GRAVITY * cos(p->sway_angle) + (p->length + p->payout) * p->sway_rate * p->sway_rate - p->der_payout_rate;
}

void plant_derivatives(Plant *p) {
    const double s = sin(p->sway_angle), c = cos(p->sway_angle);
    p->der_payout = p->payout_rate;
    p->der_payout_rate = p->hoist_bandwidth * (p->hoist_bandwidth * (p->hoist - p->payout) - 2.0 * p->payout_rate);
    p->der_position = p->velocity;
    p->der_velocity = (p->force - p->friction * p->velocity + p->load_mass * s * hanging(p)) / (p->trolley_mass + p->load_mass * s * s);
    p->der_sway_angle = p->sway_rate;
    p->der_sway_rate = -(GRAVITY * s + p->der_velocity * c + 2.0 * p->payout_rate * p->sway_rate) / (p->length + p->payout);
}

void plant_outputs(Plant *p) {
    const double s = sin(p->sway_angle);
    p->cable = p->length + p->payout;
    p->sway = p->cable * s;
    p->load = p->position + p->sway;
    p->tension = p->load_mass * (hanging(p) - p->der_velocity * s);
}

void plant_tangent(const Plant *p, Plant *d) {
    const double s = sin(p->sway_angle), c = cos(p->sway_angle), ds = c * d->sway_angle, dc = -s * d->sway_angle;
    const double cable = p->length + p->payout, d_cable = d->length + d->payout;
    const double w = p->sway_rate, dw = d->sway_rate, m = p->load_mass, dm = d->load_mass;
    const double error = p->hoist - p->payout, d_error = d->hoist - d->payout;
    d->der_payout = d->payout_rate;
    d->der_payout_rate = p->hoist_bandwidth * (p->hoist_bandwidth * d_error - 2.0 * d->payout_rate)
                         + 2.0 * d->hoist_bandwidth * (p->hoist_bandwidth * error - p->payout_rate);
    const double hangs = hanging(p), d_hangs = GRAVITY * dc + d_cable * w * w + 2.0 * cable * w * dw - d->der_payout_rate;
    d->der_position = d->velocity;
    d->der_velocity = (d->force - p->friction * d->velocity - d->friction * p->velocity + dm * s * hangs + m * ds * hangs + m * s * d_hangs
                       - p->der_velocity * (d->trolley_mass + dm * s * s + 2.0 * m * s * ds)) / (p->trolley_mass + m * s * s);
    d->der_sway_angle = dw;
    d->der_sway_rate = -(GRAVITY * ds + d->der_velocity * c + p->der_velocity * dc + 2.0 * d->payout_rate * w + 2.0 * p->payout_rate * dw
                         + p->der_sway_rate * d_cable) / cable;
    d->cable = d_cable;
    d->sway = cable * ds + d_cable * s;
    d->load = d->position + d->sway;
    d->tension = dm * (hangs - p->der_velocity * s) + m * (d_hangs - d->der_velocity * s - p->der_velocity * ds);
}

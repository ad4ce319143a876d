/* Two stirred tanks in series, dosed at both, in which what is dosed decays. See README.md. */
#include "plant.h"

void plant_derivatives(Plant *p) {
    const double into_1 = (1.0 - p->bypass) * p->dosing, into_2 = p->bypass * p->dosing;
    p->der_concentration_1 = (into_1 - p->flow * p->concentration_1) / p->volume_1 - p->decay * p->concentration_1;
    p->der_concentration_2 = (into_2 + p->flow * (p->concentration_1 - p->concentration_2)) / p->volume_2 - p->decay * p->concentration_2;
}

void plant_outputs(Plant *p) { p->outflow = p->flow * p->concentration_2; }

void plant_tangent(const Plant *p, Plant *d) {
    const double c_1 = p->concentration_1, c_2 = p->concentration_2, d_1 = d->concentration_1, d_2 = d->concentration_2;
    const double into_1 = (1.0 - p->bypass) * d->dosing - d->bypass * p->dosing;
    const double into_2 = p->bypass * d->dosing + d->bypass * p->dosing;
    /* What a volume divides, all but the decay: that over the volume is the derivative and the decay. */
    const double mixing_1 = p->der_concentration_1 + p->decay * c_1;
    const double mixing_2 = p->der_concentration_2 + p->decay * c_2;
    d->der_concentration_1 = (into_1 - p->flow * d_1 - d->flow * c_1 - mixing_1 * d->volume_1) / p->volume_1
                             - p->decay * d_1 - d->decay * c_1;
    d->der_concentration_2 = (into_2 + p->flow * (d_1 - d_2) + d->flow * (c_1 - c_2) - mixing_2 * d->volume_2) / p->volume_2
                             - p->decay * d_2 - d->decay * c_2;
    d->outflow = p->flow * d_2 + d->flow * c_2;
}

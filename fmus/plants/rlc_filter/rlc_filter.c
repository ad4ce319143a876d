/* An amplifier that feeds a load through an LC low-pass filter. See README.md. */
#include "plant.h"

void plant_derivatives(Plant *p) {
    p->der_drive = (p->gain * p->reference - p->drive) / p->lag;
    p->der_current = (p->drive - p->resistance * p->current - p->voltage) / p->inductance;
    p->der_voltage = (p->current - p->voltage / p->load) / p->capacitance;
}

void plant_outputs(Plant *p) { p->load_current = p->voltage / p->load; }

void plant_tangent(const Plant *p, Plant *d) {
    d->load_current = (d->voltage - p->load_current * d->load) / p->load;
    d->der_drive = (p->gain * d->reference + d->gain * p->reference - d->drive - p->der_drive * d->lag) / p->lag;
    d->der_current = (d->drive - p->resistance * d->current - d->resistance * p->current - d->voltage - p->der_current * d->inductance)
                     / p->inductance;
    d->der_voltage = (d->current - d->load_current - p->der_voltage * d->capacitance) / p->capacitance;
}

/* A robot arm of two links in a horizontal plane: the shoulder is driven through a flexible joint, the elbow held by another.
 * See README.md. */
#include "plant.h"

#include <math.h>

/* The inertia of the two links and the payload: about the shoulder joint folded to a point, about the elbow, and what couples them. */
typedef struct {
    double shoulder, elbow, coupling;
} Inertia;

static Inertia inertia(const Plant *p) {
    const double l_1 = p->length_1, l_2 = p->length_2;
    return (Inertia){
        .shoulder = (p->mass_1 / 3.0 + p->mass_2 + p->payload) * l_1 * l_1,
        .elbow = (p->mass_2 / 3.0 + p->payload) * l_2 * l_2,
        .coupling = (p->mass_2 / 2.0 + p->payload) * l_1 * l_2,
    };
}

static Inertia d_inertia(const Plant *p, const Plant *d) {
    const double l_1 = p->length_1, l_2 = p->length_2, d_1 = d->length_1, d_2 = d->length_2;
    return (Inertia){
        .shoulder = (d->mass_1 / 3.0 + d->mass_2 + d->payload) * l_1 * l_1 + (p->mass_1 / 3.0 + p->mass_2 + p->payload) * 2.0 * l_1 * d_1,
        .elbow = (d->mass_2 / 3.0 + d->payload) * l_2 * l_2 + (p->mass_2 / 3.0 + p->payload) * 2.0 * l_2 * d_2,
        .coupling = (d->mass_2 / 2.0 + d->payload) * l_1 * l_2 + (p->mass_2 / 2.0 + p->payload) * (d_1 * l_2 + l_1 * d_2),
    };
}

/* The elbow's angle at rest, 0 for a stretched arm: the law of cosines gives it from how far the hand is to reach. */
static double elbow_cosine(const Plant *p) {
    return (p->reach * p->reach - p->length_1 * p->length_1 - p->length_2 * p->length_2) / (2.0 * p->length_1 * p->length_2);
}

static double d_elbow_angle(const Plant *p, const Plant *d) {
    const double cosine = elbow_cosine(p), l_1 = p->length_1, l_2 = p->length_2;
    const double d_cosine = (p->reach * d->reach - l_1 * d->length_1 - l_2 * d->length_2 - cosine * (d->length_1 * l_2 + l_1 * d->length_2))
                            / (l_1 * l_2);
    return -d_cosine / sqrt(1.0 - cosine * cosine);
}

/* The joints' torques on the links. */
static double shoulder_torque(double stiffness, double damping, const Plant *x) {
    return stiffness * (x->motor_angle - x->shoulder_angle) + damping * (x->motor_rate - x->shoulder_rate);
}

static double elbow_torque(double stiffness, double damping, const Plant *x) { return -stiffness * x->elbow_bend - damping * x->elbow_rate; }

void plant_derivatives(Plant *p) {
    const Inertia i = inertia(p);
    const double elbow = acos(elbow_cosine(p)) + p->elbow_bend, c = i.coupling * cos(elbow), s = i.coupling * sin(elbow);
    const double m_11 = i.shoulder + i.elbow + 2.0 * c, m_12 = i.elbow + c, m_22 = i.elbow;
    const double w_1 = p->shoulder_rate, w_2 = p->elbow_rate;
    const double drive = shoulder_torque(p->stiffness_1, p->damping_1, p);
    const double f_1 = drive + s * w_2 * (2.0 * w_1 + w_2); /* Coriolis and centrifugal torques */
    const double f_2 = elbow_torque(p->stiffness_2, p->damping_2, p) - s * w_1 * w_1;
    const double determinant = m_11 * m_22 - m_12 * m_12;
    p->der_motor_angle = p->motor_rate;
    p->der_motor_rate = (p->torque - drive) / p->motor_inertia;
    p->der_shoulder_angle = w_1;
    p->der_shoulder_rate = (m_22 * f_1 - m_12 * f_2) / determinant;
    p->der_elbow_bend = w_2;
    p->der_elbow_rate = (m_11 * f_2 - m_12 * f_1) / determinant;
}

/* The hand's angle about the shoulder, from the first link. */
static double bearing(const Plant *p, double elbow) {
    return atan2(p->length_2 * sin(elbow), p->length_1 + p->length_2 * cos(elbow));
}

static double d_bearing(const Plant *p, const Plant *d, double elbow, double d_elbow) {
    const double l_1 = p->length_1, l_2 = p->length_2, c = cos(elbow), s = sin(elbow);
    return (l_2 * (l_2 + l_1 * c) * d_elbow + s * (l_1 * d->length_2 - l_2 * d->length_1)) / (l_1 * l_1 + l_2 * l_2 + 2.0 * l_1 * l_2 * c);
}

void plant_outputs(Plant *p) {
    const double rest = acos(elbow_cosine(p));
    p->hand_angle = p->shoulder_angle + (bearing(p, rest + p->elbow_bend) - bearing(p, rest));
    p->joint_torque = shoulder_torque(p->stiffness_1, p->damping_1, p);
}

void plant_tangent(const Plant *p, Plant *d) {
    const Inertia i = inertia(p), di = d_inertia(p, d);
    const double rest = acos(elbow_cosine(p)), elbow = rest + p->elbow_bend;
    const double d_rest = d_elbow_angle(p, d), d_elbow = d_rest + d->elbow_bend;
    const double c = i.coupling * cos(elbow), s = i.coupling * sin(elbow);
    const double dc = di.coupling * cos(elbow) - s * d_elbow, ds = di.coupling * sin(elbow) + c * d_elbow;
    const double m_11 = i.shoulder + i.elbow + 2.0 * c, m_12 = i.elbow + c, m_22 = i.elbow;
    const double d_11 = di.shoulder + di.elbow + 2.0 * dc, d_12 = di.elbow + dc, d_22 = di.elbow;
    const double w_1 = p->shoulder_rate, w_2 = p->elbow_rate, dw_1 = d->shoulder_rate, dw_2 = d->elbow_rate;
    const double d_drive = shoulder_torque(p->stiffness_1, p->damping_1, d) + shoulder_torque(d->stiffness_1, d->damping_1, p);
    const double d_hold = elbow_torque(p->stiffness_2, p->damping_2, d) + elbow_torque(d->stiffness_2, d->damping_2, p);
    /* M a = f, so M da = df - dM a. */
    const double f_1 = d_drive + ds * w_2 * (2.0 * w_1 + w_2) + 2.0 * s * (dw_2 * (w_1 + w_2) + w_2 * dw_1)
                       - d_11 * p->der_shoulder_rate - d_12 * p->der_elbow_rate;
    const double f_2 = d_hold - ds * w_1 * w_1 - 2.0 * s * w_1 * dw_1 - d_12 * p->der_shoulder_rate - d_22 * p->der_elbow_rate;
    const double determinant = m_11 * m_22 - m_12 * m_12;
    d->der_motor_angle = d->motor_rate;
    d->der_motor_rate = (d->torque - d_drive - p->der_motor_rate * d->motor_inertia) / p->motor_inertia;
    d->der_shoulder_angle = dw_1;
    d->der_shoulder_rate = (m_22 * f_1 - m_12 * f_2) / determinant;
    d->der_elbow_bend = dw_2;
    d->der_elbow_rate = (m_11 * f_2 - m_12 * f_1) / determinant;
    d->hand_angle = d->shoulder_angle + (d_bearing(p, d, elbow, d_elbow) - d_bearing(p, d, rest, d_rest));
    d->joint_torque = d_drive;
}

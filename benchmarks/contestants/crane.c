/* The crane by hand, as fast as a compiler makes it: the limit for engines that start from any model.

   With e the direction from pivot to payload, n1 and n2 the directions in which it moves with phi and theta, the payload's acceleration less
   gravity has the part f_l / m along e, because the hoist carries nothing but the payload. What is left of the five equations of Lagrange is
   solved from the inside: phi and theta each by one division, then slew and trolley as two equations in two unknowns.

   Time is counted in steps, u = dt v, as in cranedyn.integrator. Numbers of the crane come from the compiler's command line. LANES cranes move
   side by side in one vector, GROUPS of them in turn, so that one computes while the other waits for a division. */

#if LANES == 1
typedef double real;
#define LANE(x, i) (x)
#else
typedef double real __attribute__((vector_size(8 * LANES)));
#define LANE(x, i) ((x)[i])
#endif

enum { GAMMA, X, PHI, THETA, L, JOINTS };

typedef struct {
    real q[JOINTS], u[JOINTS], sin_phi, cos_phi, sin_theta, cos_theta;
} crane;

static const double m = PAYLOAD, cart = TROLLEY, inner = INNER, outer = OUTER, slewing = SLEWING, g = GRAVITY * DT * DT;
static const double damping[JOINTS] = {DT * DAMP_SLEW, DT * DAMP_TROLLEY, DT * DAMP_PHI, DT * DAMP_THETA, DT * DAMP_HOIST};
static const int drives[3] = {GAMMA, X, L};
static const double stiffness[3] = {KP_SLEW, KP_TROLLEY, KP_HOIST}, damper[3] = {KD_SLEW, KD_TROLLEY, KD_HOIST};
static const double feed[3] = {FF_SLEW, FF_TROLLEY, FF_HOIST}, most[3] = {MAX_SLEW, MAX_TROLLEY, MAX_HOIST};

/* Taylor's series, to rounding on a quarter turn to either side. */
static inline real sine(real x) {
    real sum = 1.0 + 0.0 * x;
    for (int k = 20; k > 0; k -= 2) sum = 1.0 - x * x * sum * (1.0 / (k * (k + 1)));
    return x * sum;
}

static inline real cosine(real x) {
    real sum = 1.0 + 0.0 * x;
    for (int k = 21; k > 0; k -= 2) sum = 1.0 - x * x * sum * (1.0 / (k * (k + 1)));
    return sum;
}

/* Turn an angle on by less than 1.6e-3 rad: the series is cut where its terms fall below rounding. */
static inline void turn(real *sin, real *cos, real by) {
    real square = by * by, s = by * (1.0 - square * (1.0 / 6.0)), less = square * (0.5 - square * (1.0 / 24.0));
    real before = *sin;
    *sin += *cos * s - before * less;
    *cos -= before * s + *cos * less;
}

/* One physics step under efforts in units of a step. */
static inline void step(crane *c, const real effort[3]) {
    const real *q = c->q, *u = c->u;
    const real sp = c->sin_phi, cp = c->cos_phi, st = c->sin_theta, ct = c->cos_theta, x = q[X], l = q[L];
    const real turned = u[GAMMA], phi = u[PHI], theta = u[THETA], hoisted = u[L];
    const real e_r = -ct * sp, w = st * sp, lever = l * ct, x_ct = x * ct;

    /* What the payload's acceleration has of rates and gravity, along e, n1, n2. */
    const real inward = hoisted * e_r + l * theta * w - lever * phi * cp + u[X];
    const real twice = turned + turned;
    const real radial = -turned * turned * (x + l * e_r) + twice * (hoisted * st + lever * theta);
    const real aside = turned * turned * l * st + twice * inward;
    const real along = e_r * radial - st * aside - ct * (g * cp + lever * phi * phi) - l * theta * theta;
    const real across1 = g * sp - cp * radial + 2.0 * phi * (hoisted * ct - l * theta * st);
    const real across2 = w * radial - ct * aside + st * (g * cp + lever * phi * phi) + 2.0 * hoisted * theta;

    const real gyro = inner * cp * turned;
    const real h_phi = gyro * theta - damping[PHI] * phi, h_theta = -gyro * phi - damping[THETA] * theta;
    const real d1 = m * lever * lever + (inner + outer), d2 = m * l * l + inner;
    const real both = 1.0 / (d1 * d2), by_d1 = d2 * both, by_d2 = d1 * both;
    const real rho1 = m * (inner + outer) * by_d1, rho2 = m * inner * by_d2;
    const real push1 = rho1 * across1 + m * lever * by_d1 * h_phi, push2 = rho2 * across2 + m * l * by_d2 * h_theta;

    const real k1 = -l * st * cp, hoist = effort[2] - damping[L] * hoisted;
    const real m_gg = slewing + outer + inner * cp * cp + cart * x * x + rho1 * k1 * k1 + rho2 * x_ct * x_ct;
    const real m_gx = -rho1 * cp * k1 - rho2 * w * x_ct;
    const real m_xx = cart + rho1 * cp * cp + rho2 * w * w;
    const real f_g = effort[0] - turned * (damping[GAMMA] + 2.0 * cart * x * u[X]) + x * st * hoist - k1 * push1 + x_ct * push2
                     - sp * h_theta - inner * cp * theta * phi;
    const real f_x = effort[1] - damping[X] * u[X] + cart * x * turned * turned - e_r * hoist + cp * push1 - w * push2;
    const real by_det = 1.0 / (m_gg * m_xx - m_gx * m_gx);
    const real a_g = (m_xx * f_g - m_gx * f_x) * by_det, a_x = (m_gg * f_x - m_gx * f_g) * by_det;

    c->u[GAMMA] += a_g;
    c->u[X] += a_x;
    c->u[PHI] += (h_phi - m * lever * (across1 + k1 * a_g - cp * a_x)) * by_d1;
    c->u[THETA] += (h_theta - m * l * (across2 + w * a_x - x_ct * a_g)) * by_d2 - sp * a_g;
    c->u[L] += hoist * (1.0 / m) + x * st * a_g - e_r * a_x - along;
    for (int j = 0; j < JOINTS; j++) c->q[j] += c->u[j];
    turn(&c->sin_phi, &c->cos_phi, c->u[PHI]);
    turn(&c->sin_theta, &c->cos_theta, c->u[THETA]);
}

/* The hold controller within the limits of the drives, in SI. */
static inline void hold(const crane *c, const real wanted[3], real effort[3]) {
    for (int k = 0; k < 3; k++) {
        real e = feed[k] + stiffness[k] * (wanted[k] - c->q[drives[k]]) - damper[k] * (1.0 / DT) * c->u[drives[k]];
        for (int i = 0; i < LANES; i++) LANE(e, i) = LANE(e, i) > most[k] ? most[k] : LANE(e, i) < -most[k] ? -most[k] : LANE(e, i);
        effort[k] = e;
    }
}

/* Run `rounds` times LANES * GROUPS cranes for some control periods.

   starts, ends: coordinates and rates of each crane in a row of ten; peaks: the largest phi^2 + theta^2 at a control instant;
   log: rows of coordinates, rates and efforts at the control instants of a single crane, or null. */
void run(long rounds, long periods, const double *starts, double *ends, double *peaks, double *log) {
    for (long round = 0; round < rounds; round++, starts += 10 * LANES * GROUPS, ends += 10 * LANES * GROUPS, peaks += LANES * GROUPS) {
        crane c[GROUPS];
        real wanted[GROUPS][3], effort[GROUPS][3], peak[GROUPS];
        for (int n = 0; n < GROUPS; n++) {
            for (int i = 0; i < LANES; i++)
                for (int j = 0; j < JOINTS; j++) {
                    LANE(c[n].q[j], i) = starts[10 * (LANES * n + i) + j];
                    LANE(c[n].u[j], i) = DT * starts[10 * (LANES * n + i) + 5 + j];
                }
            for (int k = 0; k < 3; k++) wanted[n][k] = c[n].q[drives[k]];
            peak[n] = 0.0 * c[n].q[PHI];
        }
        for (long p = 0; p <= periods; p++) {
            for (int n = 0; n < GROUPS; n++) {
                const real swing = c[n].q[PHI] * c[n].q[PHI] + c[n].q[THETA] * c[n].q[THETA];
                for (int i = 0; i < LANES; i++) LANE(peak[n], i) = LANE(swing, i) > LANE(peak[n], i) ? LANE(swing, i) : LANE(peak[n], i);
                hold(&c[n], wanted[n], effort[n]);
                if (log && LANES * GROUPS == 1) {
                    for (int j = 0; j < JOINTS; j++) log[j] = LANE(c[n].q[j], 0), log[5 + j] = LANE(c[n].u[j], 0) * (1.0 / DT);
                    for (int k = 0; k < 3; k++) log[10 + k] = LANE(effort[n][k], 0);
                    log += 13;
                }
                for (int k = 0; k < 3; k++) effort[n][k] *= DT * DT;
                c[n].sin_phi = sine(c[n].q[PHI]), c[n].cos_phi = cosine(c[n].q[PHI]);
                c[n].sin_theta = sine(c[n].q[THETA]), c[n].cos_theta = cosine(c[n].q[THETA]);
            }
            if (p == periods) break;
            for (int s = 0; s < STEPS; s++)
                for (int n = 0; n < GROUPS; n++) step(&c[n], effort[n]);
        }
        for (int n = 0; n < GROUPS; n++)
            for (int i = 0; i < LANES; i++) {
                for (int j = 0; j < JOINTS; j++) {
                    ends[10 * (LANES * n + i) + j] = LANE(c[n].q[j], i);
                    ends[10 * (LANES * n + i) + 5 + j] = LANE(c[n].u[j], i) * (1.0 / DT);
                }
                peaks[LANES * n + i] = LANE(peak[n], i);
            }
    }
}

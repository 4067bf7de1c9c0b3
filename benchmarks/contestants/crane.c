/* The crane by hand, as fast as a compiler makes it: the limit for engines that start from any model.

   With e the direction from pivot to payload, n1 and n2 the directions in which it moves with phi and theta, the payload's
   acceleration less gravity has the part f_l / m along e, because the hoist carries nothing but the payload. What is left of the
   five equations of Lagrange is solved from the inside: the swings, each by itself, then slew and trolley as two equations.

   Time is counted in steps, u = dt v, as in cranedyn.integrator, and mass in that of the payload. Numbers of the crane come from
   the compiler's command line. LANES cranes move side by side in one vector, GROUPS of vectors in turn, so that one computes while
   the other waits for a division. */

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

static const double cart = TROLLEY / PAYLOAD, inner = INNER / PAYLOAD, both = (INNER + OUTER) / PAYLOAD, g = GRAVITY * DT * DT;
static const double slewing = (SLEWING + OUTER) / PAYLOAD, unit = DT * DT / PAYLOAD, per = DT / PAYLOAD;
static const double damping[JOINTS] = {per * DAMP_SLEW, per * DAMP_TROLLEY, per * DAMP_PHI, per * DAMP_THETA, per * DAMP_HOIST};
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

/* One physics step under efforts in units of a step and of the payload's mass. */
static inline void step(crane *c, const real effort[3]) {
    const real x = c->q[X], l = c->q[L], slew = c->u[GAMMA], out = c->u[X], phi = c->u[PHI], theta = c->u[THETA], down = c->u[L];
    const real sp = c->sin_phi, cp = c->cos_phi, st = c->sin_theta, ct = c->cos_theta;
    const real lever = l * ct, offset = l * st, level = ct * sp, tilt = st * sp, x_ct = x * ct, x_st = x * st;

    /* What the payload's acceleration has of rates and gravity: in the plane of phi, across it, and from there along e, n1, n2. */
    const real v_theta = l * theta, v_phi = lever * phi, v_down = down * ct - v_theta * st, v_across = down * st + v_theta * ct;
    const real radial = slew * (2.0 * v_across - slew * (x - lever * sp));
    const real aside = slew * (slew * offset + 2.0 * (out - sp * v_down - cp * v_phi));
    const real below = sp * radial + cp * g + v_phi * phi;
    const real along = -ct * below - st * aside - v_theta * theta;
    const real across1 = sp * g - cp * radial + 2.0 * phi * v_down;
    const real across2 = st * below - ct * aside + 2.0 * down * theta;

    /* The swings by what does not depend on slew and trolley. */
    const real spin = inner * cp, spin_phi = spin * phi;
    const real h_phi = spin * theta * slew - damping[PHI] * phi, h_theta = -spin_phi * slew - damping[THETA] * theta;
    const real d1 = lever * lever + both, d2 = l * l + inner, inverse = 1.0 / (d1 * d2), by_d1 = d2 * inverse, by_d2 = d1 * inverse;
    const real to1 = lever * by_d1, to2 = l * by_d2, rho1 = both * by_d1, rho2 = inner * by_d2;
    const real push1 = cp * (rho1 * across1 + to1 * h_phi), push2 = rho2 * across2 + to2 * h_theta;

    /* Slew and trolley. */
    const real cp2 = cp * cp, share = rho1 * cp2, share_x = rho2 * x_ct, hoist = effort[2] - damping[L] * down;
    const real m_gg = slewing + inner * cp2 + cart * x * x + share * offset * offset + share_x * x_ct;
    const real m_gx = share * offset - share_x * tilt, m_xx = cart + share + rho2 * tilt * tilt;
    const real cart_slew = cart * x * slew;
    const real f_g = effort[0] - damping[GAMMA] * slew - 2.0 * cart_slew * out + x_st * hoist + offset * push1 + x_ct * push2 - sp * h_theta
                     - spin_phi * theta;
    const real f_x = effort[1] - damping[X] * out + cart_slew * slew + level * hoist + push1 - tilt * push2;
    const real by_det = 1.0 / (m_gg * m_xx - m_gx * m_gx);
    const real a_g = (m_xx * f_g - m_gx * f_x) * by_det, a_x = (m_gg * f_x - m_gx * f_g) * by_det;

    c->u[GAMMA] += a_g;
    c->u[X] += a_x;
    c->u[PHI] += by_d1 * h_phi - to1 * (across1 - cp * (offset * a_g + a_x));
    c->u[THETA] += by_d2 * h_theta - to2 * (across2 + tilt * a_x - x_ct * a_g) - sp * a_g;
    c->u[L] += hoist + x_st * a_g + level * a_x - along;
    for (int j = 0; j < JOINTS; j++) c->q[j] += c->u[j];
    turn(&c->sin_phi, &c->cos_phi, c->u[PHI]);
    turn(&c->sin_theta, &c->cos_theta, c->u[THETA]);
}

/* The hold controller within the limits of the drives, in SI. */
static inline void hold(const crane *c, const real wanted[3], real command[3], real effort[3]) {
    for (int k = 0; k < 3; k++) {
        real e = feed[k] + stiffness[k] * (wanted[k] - c->q[drives[k]]) - damper[k] * (1.0 / DT) * c->u[drives[k]];
        command[k] = e;
        for (int i = 0; i < LANES; i++) LANE(e, i) = LANE(e, i) > most[k] ? most[k] : LANE(e, i) < -most[k] ? -most[k] : LANE(e, i);
        effort[k] = e;
    }
}

#ifdef BASE
/* Energy of a single crane, from the velocities of the payload along the jib, across it and upwards; zero at the ground. */
static inline double energy(const crane *c) {
    const double x = c->q[X], l = c->q[L], slew = c->u[GAMMA], out = c->u[X], phi = c->u[PHI], theta = c->u[THETA], down = c->u[L];
    const double sp = c->sin_phi, cp = c->cos_phi, st = c->sin_theta, ct = c->cos_theta, lever = l * ct;
    const double v_down = down * ct - l * theta * st, v_phi = lever * phi, spin = theta + sp * slew;
    const double along = out - sp * v_down - cp * v_phi + slew * l * st, up = sp * v_phi - cp * v_down;
    const double across = down * st + l * theta * ct - slew * (x - lever * sp);
    const double motion = slewing * slew * slew + cart * (out * out + x * x * slew * slew) + along * along + across * across + up * up
                          + both * phi * phi + inner * (spin * spin + cp * cp * slew * slew);
    return (0.5 * motion + g * (BASE - lever * cp)) * (PAYLOAD / (DT * DT));
}

static const double low[JOINTS] = {LOW_SLEW, LOW_TROLLEY, LOW_PHI, LOW_THETA, LOW_HOIST}, quarter = 1.5707963267948966;
static const double high[JOINTS] = {HIGH_SLEW, HIGH_TROLLEY, HIGH_PHI, HIGH_THETA, HIGH_HOIST};
static const double rate[3] = {RATE_SLEW, RATE_TROLLEY, RATE_HOIST};

/* Whether joints and drives are within their ranges, the rope pulls, and the payload is above the ground. */
static inline int valid(const crane *c, const double effort[3]) {
    int holds = c->q[PHI] >= -quarter && c->q[PHI] <= quarter && c->q[THETA] >= -quarter && c->q[THETA] <= quarter;
    for (int j = 0; j < JOINTS; j++) holds &= c->q[j] >= low[j] && c->q[j] <= high[j];
    for (int k = 0; k < 3; k++) holds &= c->u[drives[k]] >= -DT * rate[k] && c->u[drives[k]] <= DT * rate[k];
    return holds & (DAMP_HOIST / DT * c->u[L] - effort[2] > 0.0) & (PIVOT - c->q[L] * c->cos_theta * c->cos_phi >= 0.0);
}

typedef struct {
    double middle[3], exerted[3], work[3], power, dissipated;
} balance;

/* Log a row of coordinates, rates, efforts, setpoint, commands, forces and work from outside, energy, work and dissipation so far,
   and validity; the first one begins the balance. */
static double *ledger(double *log, const crane *c, const double wanted[3], const double command[3], const double effort[3], balance *b,
                      int first) {
    double now = 0.0;
    for (int j = 0; j < JOINTS; j++) *log++ = c->q[j];
    for (int j = 0; j < JOINTS; j++) *log++ = c->u[j] * (1.0 / DT), now += damping[j] / per * log[-1] * log[-1];
    for (int k = 0; k < 3; k++) *log++ = effort[k];
    for (int k = 0; k < 3; k++) *log++ = wanted[k];
    for (int k = 0; k < 3; k++) *log++ = command[k];
    for (int i = 0; i < OUTSIDE; i++) *log++ = 0.0;
    *log++ = energy(c);
    for (int k = 0; k < 3; k++) {
        const double reached = c->q[drives[k]] - 0.5 * c->u[drives[k]];
        b->work[k] = first ? 0.0 : b->work[k] + b->exerted[k] * (reached - b->middle[k]);
        b->middle[k] = reached, b->exerted[k] = effort[k], *log++ = b->work[k];
    }
    b->dissipated = first ? 0.0 : b->dissipated + 0.5 * (b->power + now) * (DT * STEPS);
    b->power = now, *log++ = b->dissipated, *log++ = valid(c, effort);
    return log;
}
#endif

/* Run `rounds` times LANES * GROUPS cranes for some control periods.

   starts, ends: coordinates and rates of each crane in a row of ten; peaks: the largest phi^2 + theta^2 at a control instant;
   log: rows of coordinates, rates and efforts at the control instants of a single crane, with BASE those of `ledger`, or null. */
void run(long rounds, long periods, const double *starts, double *ends, double *peaks, double *log) {
    for (long round = 0; round < rounds; round++, starts += 10 * LANES * GROUPS, ends += 10 * LANES * GROUPS, peaks += LANES * GROUPS) {
        crane c[GROUPS];
        real wanted[GROUPS][3], effort[GROUPS][3], command[3], peak[GROUPS];
#ifdef BASE
        balance kept;
#endif
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
                c[n].sin_phi = sine(c[n].q[PHI]), c[n].cos_phi = cosine(c[n].q[PHI]);
                c[n].sin_theta = sine(c[n].q[THETA]), c[n].cos_theta = cosine(c[n].q[THETA]);
                hold(&c[n], wanted[n], command, effort[n]);
#ifdef BASE
                log = ledger(log, &c[n], wanted[n], command, effort[n], &kept, p == 0);
#else
                if (log && LANES * GROUPS == 1) {
                    for (int j = 0; j < JOINTS; j++) log[j] = LANE(c[n].q[j], 0), log[5 + j] = LANE(c[n].u[j], 0) * (1.0 / DT);
                    for (int k = 0; k < 3; k++) log[10 + k] = LANE(effort[n][k], 0);
                    log += 13;
                }
#endif
                for (int k = 0; k < 3; k++) effort[n][k] *= unit;
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

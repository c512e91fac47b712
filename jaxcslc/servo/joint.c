/* Joints of position servos through recorded commands; read with `_simulation.py` and `arm.c`.

   Time stepping at the level of velocities (Moreau; Stewart and Trinkle, 1996): a step of h takes
   the velocity v to the one that solves the implicit equation of motion

       M (v+ - v) = h (tau(mean) - bias - friction(v+)) + impulses of stops and play

   where tau depends on a mean of v and v+, which makes the step second order without friction.
   Friction is implicit, so that a joint at rest stays exactly at rest. In one joint every force
   falls monotonically with v+, and the equation has one solution in closed form. */

#include <math.h>

/* The order of the fields of `ServoDrive`. */
enum {
  GAIN, DAMPING, INTEGRAL, LEAD, DELAY, DEAD_ZONE, TORQUE_LIMIT, SPEED_LIMIT, OFFSET, ENCODER_STEP,
  ARMATURE, COULOMB, VISCOUS, STATIC, STRIBECK, LOAD_FRICTION, PLAY, LOW, HIGH, PARAMETERS
};

typedef struct {
  double r;        /* reading of the joint side */
  double v;        /* velocity of the joint side */
  double motor;    /* velocity of the motor side; v without play */
  double gap;      /* motor side minus joint side, within half the play */
  double integral; /* of the position error */
  double slope;    /* 1 where the servo acts on position, 0 in the dead zone */
  double push;     /* its torque at this position and at velocity 0 */
  double friction; /* level of friction */
} Joint;

static double least(double a, double b) { return a < b ? a : b; }
static double most(double a, double b) { return a > b ? a : b; }

/* What a step takes from its beginning. */
static void begin(Joint *s, const double *p, double command, double rate, double load, double h) {
  double e = command - s->r, zone = p[DEAD_ZONE];
  s->slope = 1.0;
  if (zone > 0.0) {
    double outside = e > zone ? e - zone : e < -zone ? e + zone : 0.0;
    s->slope = outside != 0.0;
    e = outside;
  }
  if (p[INTEGRAL] > 0.0) s->integral += h * e;
  s->push = p[GAIN] * e + p[INTEGRAL] * s->integral + p[DAMPING] * p[LEAD] * rate;
  s->friction = p[COULOMB] + p[LOAD_FRICTION] * fabs(load);
  if (p[STATIC] > 0.0) {
    double x = s->motor / p[STRIBECK];
    s->friction += p[STATIC] * exp(-x * x);
  }
}

/* What a step does to one side of the gear: its velocity afterwards, and the mean over the step. */
typedef struct {
  double v, mean;
} Step;

/* A step of an inertia A with velocity v and momentum b, under the torque push - falling * mean and
   friction of level F, which may hold it. The mean velocity is that of a damped motion, which
   decays as an exponential: both velocities count alike in short steps, the later one in long. */
static Step slide(double A, double b, double v, double push, double falling, double F, double h) {
  double z = h * falling / A;
  double w = z < 1e-3 ? 0.5 + z / 12.0 : 1.0 / -expm1(-z) - 1.0 / z;
  double x = b + h * (push - (1.0 - w) * falling * v), hold = h * F;
  x = x > hold ? x - hold : x < -hold ? x + hold : 0.0;
  double after = x / (A + h * w * falling);
  return (Step){after, w * after + (1.0 - w) * v};
}

/* The servo's step of an inertia A with velocity v and momentum b. Its spring acts on the reading in
   the middle of the step. The reading's mean velocity is share * mean - ahead, where mean is that of
   the motor side: share is 1 in contact and 0 within the play. */
static Step drive(const Joint *s, const double *p, double A, double b, double v, double share,
                  double ahead, double h) {
  double limit = p[TORQUE_LIMIT], viscous = p[VISCOUS], spring = 0.5 * h * s->slope * p[GAIN];
  double falling = p[DAMPING] + share * spring, push = s->push + spring * ahead;
  Step step = slide(A, b, v, push, falling + viscous, s->friction, h);
  if (isinf(limit)) return step;
  double fall = isinf(p[SPEED_LIMIT]) ? 0.0 : limit / p[SPEED_LIMIT];
  double torque = push - falling * step.mean;
  double sign = torque > limit - fall * step.mean ? 1.0 : torque < -limit - fall * step.mean ? -1.0 : 0.0;
  if (sign == 0.0) return step;
  return slide(A, b, v, sign * limit, fall + viscous, s->friction, h);
}

/* A step of a joint whose links have inertia m and momentum b after their forces. */
static void solve(const Joint *s, const double *p, double m, double b, double h, Step *links,
                  Step *motor) {
  double J = p[ARMATURE], half = 0.5 * p[PLAY];
  if (half == 0.0) {
    *motor = drive(s, p, m + J, b + J * s->motor, s->motor, 1.0, 0.0, h);
    *links = *motor;
  } else {
    *links = (Step){b / m, 0.5 * (s->v + b / m)};
    *motor = drive(s, p, J, J * s->motor, s->motor, 0.0, -links->mean, h);
    double gap = s->gap + h * (motor->mean - links->mean);
    if (gap > half || gap < -half) { /* both flanks move together */
      /* Of the mean velocities: w apart. Momentum counts links as fast as the motor side. */
      double w = ((gap > half ? half : -half) - s->gap) / h;
      double v = (m * (s->v + w) + J * s->motor) / (m + J);
      *motor = drive(s, p, m + J, b + m * w + J * s->motor, v, 1.0, w, h);
      *links = (Step){motor->v - w, motor->mean - w};
    }
  }
  double after = s->r + h * links->mean;
  if (after > p[HIGH]) *links = (Step){least(links->v, 0.0), (p[HIGH] - s->r) / h};
  if (after < p[LOW]) *links = (Step){most(links->v, 0.0), (p[LOW] - s->r) / h};
  if (half == 0.0) *motor = *links;
}

static void finish(Joint *s, Step links, Step motor, double half, double h) {
  s->gap = half > 0.0 ? least(half, most(-half, s->gap + h * (motor.mean - links.mean))) : 0.0;
  s->r += h * links.mean;
  s->v = links.v;
  s->motor = motor.v;
}

/* A held command, averaged over a step. */
typedef struct {
  const double *time, *command, *sum; /* sum: time integral of the held command */
  long samples, stride, at;
} Command;

static double integral(Command *c, double t) {
  while (c->at + 1 < c->samples && c->time[c->at + 1] <= t) c->at++;
  while (c->at > 0 && c->time[c->at] > t) c->at--;
  return c->sum[c->at * c->stride] + (t - c->time[c->at]) * c->command[c->at * c->stride];
}

static double slope(const Command *c) {
  long i = c->at + 1 < c->samples ? c->at : c->samples - 2, k = c->stride;
  return c->time[c->at] > c->time[i + 1] ? 0.0
         : (c->command[(i + 1) * k] - c->command[i * k]) / (c->time[i + 1] - c->time[i]);
}

/* Where the gear of a joint is that has been at rest: on the flank that carries its load. */
static double flank(const double *p, double load) {
  double half = 0.5 * p[PLAY];
  return load > 0.0 ? half : load < 0.0 ? -half : 0.0;
}

/* One joint, the others known: `load`, its torque (samples, 4) as load[0] + load[1] cos q +
   load[2] sin q + load[3], where load[3] is of the others' accelerations, which friction does not
   feel; `inertia` of the links it carries (samples,). Several sets of parameters. */
void simulate_joint(const double *time, const double *command, const double *sum,
                    const double *inertia, const double *load, const double *drives,
                    const double *start, double *position, long samples, long sets, long substeps) {
  for (long set = 0; set < sets; set++) {
    const double *p = drives + set * PARAMETERS;
    double *out = position + set * samples;
    double q0 = start[0] - p[OFFSET];
    double held = load[0] + load[1] * cos(q0) + load[2] * sin(q0);
    Joint s = {.r = start[0], .v = start[1], .motor = start[1], .gap = flank(p, held)};
    Command c = {time, command, sum, samples, 1, 0};
    double before = integral(&c, time[0] - p[DELAY]);
    out[0] = s.r;
    for (long n = 0; n + 1 < samples; n++) {
      double h = (time[n + 1] - time[n]) / substeps;
      const double *a = load + 4 * n, *b = a + 4;
      for (long k = 0; k < substeps; k++) {
        double x = (k + 0.5) / substeps, q = s.r - p[OFFSET];
        double after = integral(&c, time[n] + (k + 1) * h - p[DELAY]);
        double m = inertia[n] + x * (inertia[n + 1] - inertia[n]);
        double bias = a[0] + x * (b[0] - a[0]) + (a[1] + x * (b[1] - a[1])) * cos(q) +
                      (a[2] + x * (b[2] - a[2])) * sin(q);
        double torque = bias + a[3] + x * (b[3] - a[3]);
        Step links, motor;
        begin(&s, p, (after - before) / h, p[LEAD] > 0.0 ? slope(&c) : 0.0, bias, h);
        solve(&s, p, m, m * s.v - h * torque, h, &links, &motor);
        finish(&s, links, motor, 0.5 * p[PLAY], h);
        before = after;
      }
      out[n + 1] = s.r;
    }
  }
}

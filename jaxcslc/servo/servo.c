/* Arms of position servos through recorded commands; read with `_simulation.py`.

   Time stepping at the level of velocities (Moreau; Stewart and Trinkle, 1996): a step of h takes
   the velocity v to the one that solves the implicit equation of motion

       M (v+ - v) = h (tau(mean) - bias - friction(v+)) + impulses of stops and play

   where tau depends on a mean of v and v+, which makes the step second order without friction.
   Friction is implicit, so that a joint at rest stays exactly at rest. In one joint every force
   falls monotonically with v+, and the equation has one solution in closed form. */

#include <math.h>
#include <string.h>

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

/* The servo's step of an inertia A with momentum b. Its spring acts in the middle of the step. */
static Step drive(const Joint *s, const double *p, double A, double b, double h) {
  double limit = p[TORQUE_LIMIT], viscous = p[VISCOUS], v = s->motor;
  double falling = p[DAMPING] + 0.5 * h * s->slope * p[GAIN];
  Step step = slide(A, b, v, s->push, falling + viscous, s->friction, h);
  if (isinf(limit)) return step;
  double fall = isinf(p[SPEED_LIMIT]) ? 0.0 : limit / p[SPEED_LIMIT];
  double torque = s->push - falling * step.mean;
  double sign = torque > limit - fall * step.mean ? 1.0 : torque < -limit - fall * step.mean ? -1.0 : 0.0;
  if (sign == 0.0) return step;
  return slide(A, b, v, sign * limit, fall + viscous, s->friction, h);
}

/* A step of a joint whose links have inertia m and momentum b after their forces. */
static void solve(const Joint *s, const double *p, double m, double b, double h, Step *links,
                  Step *motor) {
  double J = p[ARMATURE], half = 0.5 * p[PLAY];
  if (half == 0.0) {
    *motor = drive(s, p, m + J, b + J * s->motor, h);
    *links = *motor;
  } else {
    *motor = drive(s, p, J, J * s->motor, h);
    *links = (Step){b / m, 0.5 * (s->v + b / m)};
    double gap = s->gap + h * (motor->mean - links->mean);
    if (gap > half || gap < -half) { /* both flanks move together */
      double w = ((gap > half ? half : -half) - s->gap) / h;
      *motor = drive(s, p, m + J, b + m * w + J * s->motor, h);
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

/* Rigid bodies. Spatial vectors in the base frame, about its origin: angular part first. */
typedef struct {
  long joints;
  const long *parent, *slides; /* -1 for the base; 1 for a prismatic joint */
  const double *placement;     /* (joints, 12): rotation by rows and origin at position 0 */
  const double *body;          /* (joints, 10): mass, centre, Ixx Iyy Izz Ixy Ixz Iyz there */
  const double *gravity;
} Arm;

typedef struct {
  double R[9], o[3], S[6];  /* pose of the link's frame, axis of its joint */
  double m, c[3], I[9];     /* mass, first moment, inertia about the origin */
  double V[6], A[6], F[6];
} Link;

static void cross(const double *a, const double *b, double *out) {
  out[0] = a[1] * b[2] - a[2] * b[1];
  out[1] = a[2] * b[0] - a[0] * b[2];
  out[2] = a[0] * b[1] - a[1] * b[0];
}

static double dot(const double *a, const double *b, long n) {
  double sum = 0.0;
  for (long i = 0; i < n; i++) sum += a[i] * b[i];
  return sum;
}

static void product(const double *a, const double *b, double *out) {
  for (long i = 0; i < 3; i++)
    for (long j = 0; j < 3; j++)
      out[3 * i + j] = a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j];
}

/* Momentum of a body, (I w + c x v, m v - c x w). */
static void momentum(const Link *l, const double *V, double *out) {
  double a[3], b[3];
  cross(l->c, V + 3, a);
  cross(l->c, V, b);
  for (long i = 0; i < 3; i++) {
    out[i] = dot(l->I + 3 * i, V, 3) + a[i];
    out[3 + i] = l->m * V[3 + i] - b[i];
  }
}

static void place(const Arm *arm, const double *q, Link *links) {
  static const double unit[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, zero[3] = {0, 0, 0};
  for (long i = 0; i < arm->joints; i++) {
    Link *l = links + i;
    const double *T = arm->placement + 12 * i, *b = arm->body + 10 * i;
    const double *Rp = arm->parent[i] < 0 ? unit : links[arm->parent[i]].R;
    const double *op = arm->parent[i] < 0 ? zero : links[arm->parent[i]].o;
    double fixed[9], turned[9], half[9], *z = l->S + 3 * arm->slides[i], centre[3];
    product(Rp, T, fixed);
    for (long k = 0; k < 3; k++) {
      l->o[k] = op[k] + dot(Rp + 3 * k, T + 9, 3);
      z[k] = fixed[3 * k + 2];
    }
    memcpy(l->R, fixed, sizeof fixed);
    if (arm->slides[i]) {
      for (long k = 0; k < 3; k++) l->o[k] += q[i] * z[k], l->S[k] = 0.0;
    } else {
      double c = cos(q[i]), s = sin(q[i]);
      for (long k = 0; k < 3; k++) {
        l->R[3 * k] = c * fixed[3 * k] + s * fixed[3 * k + 1];
        l->R[3 * k + 1] = c * fixed[3 * k + 1] - s * fixed[3 * k];
      }
      cross(l->o, z, l->S + 3);
    }
    const double I[9] = {b[4], b[7], b[8], b[7], b[5], b[9], b[8], b[9], b[6]};
    product(l->R, I, half);
    for (long r = 0; r < 3; r++)
      for (long k = 0; k < 3; k++) turned[3 * r + k] = dot(half + 3 * r, l->R + 3 * k, 3);
    l->m = b[0];
    for (long k = 0; k < 3; k++) centre[k] = l->o[k] + dot(l->R + 3 * k, b + 1, 3);
    double square = dot(centre, centre, 3);
    for (long r = 0; r < 3; r++) {
      l->c[r] = l->m * centre[r];
      for (long k = 0; k < 3; k++)
        l->I[3 * r + k] = turned[3 * r + k] + l->m * ((r == k) * square - centre[r] * centre[k]);
    }
  }
}

/* Torques by Newton and Euler's equations; `links` placed. */
static void newton_euler(const Arm *arm, const double *v, const double *a, Link *links,
                         double *torque) {
  for (long i = 0; i < arm->joints; i++) {
    Link *l = links + i, *p = arm->parent[i] < 0 ? 0 : links + arm->parent[i];
    double w[6], P[6], x[3], y[3];
    for (long k = 0; k < 6; k++) {
      w[k] = l->S[k] * v[i];
      l->V[k] = (p ? p->V[k] : 0.0) + w[k];
      l->A[k] = (p ? p->A[k] : k < 3 ? 0.0 : -arm->gravity[k - 3]) + l->S[k] * a[i];
    }
    cross(l->V, w, x); /* V x w */
    for (long k = 0; k < 3; k++) l->A[k] += x[k];
    cross(l->V, w + 3, x);
    cross(l->V + 3, w, y);
    for (long k = 0; k < 3; k++) l->A[3 + k] += x[k] + y[k];
    momentum(l, l->A, l->F);
    momentum(l, l->V, P); /* V x* P */
    cross(l->V, P, x);
    cross(l->V + 3, P + 3, y);
    for (long k = 0; k < 3; k++) l->F[k] += x[k] + y[k];
    cross(l->V, P + 3, x);
    for (long k = 0; k < 3; k++) l->F[3 + k] += x[k];
  }
  for (long i = arm->joints - 1; i >= 0; i--) {
    torque[i] = dot(links[i].S, links[i].F, 6);
    if (arm->parent[i] >= 0)
      for (long k = 0; k < 6; k++) links[arm->parent[i]].F[k] += links[i].F[k];
  }
}

/* Mass matrix of composite bodies; `links` placed, their inertias used up. */
static void mass_matrix(const Arm *arm, Link *links, double *M) {
  long n = arm->joints;
  memset(M, 0, n * n * sizeof *M);
  for (long i = n - 1; i >= 0; i--) {
    double P[6];
    momentum(links + i, links[i].S, P);
    for (long j = i; j >= 0; j = arm->parent[j]) M[n * i + j] = M[n * j + i] = dot(links[j].S, P, 6);
    if (arm->parent[i] < 0) continue;
    Link *p = links + arm->parent[i];
    p->m += links[i].m;
    for (long k = 0; k < 3; k++) p->c[k] += links[i].c[k];
    for (long k = 0; k < 9; k++) p->I[k] += links[i].I[k];
  }
}

/* Torques (samples, joints) of motions, and mass matrices (samples, joints, joints) if asked for. */
void inverse_dynamics(const long *parent, const long *slides, const double *placement,
                      const double *body, const double *gravity, const double *q, const double *v,
                      const double *a, double *torque, double *mass, long samples, long joints) {
  Arm arm = {joints, parent, slides, placement, body, gravity};
  Link links[joints];
  for (long n = 0; n < samples; n++) {
    place(&arm, q + n * joints, links);
    newton_euler(&arm, v + n * joints, a + n * joints, links, torque + n * joints);
    if (mass) mass_matrix(&arm, links, mass + n * joints * joints);
  }
}

/* A whole arm. Joints are coupled by the mass matrix; a step solves them in turn until no velocity
   changes by more than `tolerance` (Gauss and Seidel: the matrix is positive definite). */
void simulate_arm(const long *parent, const long *slides, const double *placement,
                  const double *body, const double *gravity, const double *drives,
                  const double *time, const double *command, const double *sum,
                  const double *start, double *position, long samples, long joints,
                  long substeps, long sweeps, double tolerance) {
  Arm arm = {joints, parent, slides, placement, body, gravity};
  Link links[joints];
  Joint state[joints];
  Command commands[joints];
  double q[joints], v[joints], zero[joints], bias[joints], M[joints * joints], before[joints];
  Step new[joints], motor[joints];
  for (long i = 0; i < joints; i++) {
    const double *p = drives + i * PARAMETERS;
    state[i] = (Joint){.r = start[i], .v = start[joints + i], .motor = start[joints + i]};
    commands[i] = (Command){time, command + i, sum + i, samples, joints, 0};
    before[i] = integral(commands + i, time[0] - p[DELAY]);
    position[i] = start[i];
    zero[i] = 0.0;
    q[i] = start[i] - p[OFFSET];
  }
  place(&arm, q, links);
  newton_euler(&arm, zero, zero, links, bias);
  for (long i = 0; i < joints; i++) state[i].gap = flank(drives + i * PARAMETERS, bias[i]);
  for (long n = 0; n + 1 < samples; n++) {
    double h = (time[n + 1] - time[n]) / substeps;
    for (long k = 0; k < substeps; k++) {
      for (long i = 0; i < joints; i++) {
        q[i] = state[i].r - drives[i * PARAMETERS + OFFSET];
        v[i] = state[i].v;
      }
      place(&arm, q, links);
      newton_euler(&arm, v, zero, links, bias);
      mass_matrix(&arm, links, M);
      for (long i = 0; i < joints; i++) {
        const double *p = drives + i * PARAMETERS;
        double after = integral(commands + i, time[n] + (k + 1) * h - p[DELAY]);
        begin(state + i, p, (after - before[i]) / h, p[LEAD] > 0.0 ? slope(commands + i) : 0.0,
              bias[i], h);
        before[i] = after;
        new[i] = (Step){v[i], v[i]};
      }
      for (long sweep = 0; sweep < sweeps; sweep++) {
        double change = 0.0;
        for (long i = 0; i < joints; i++) {
          double b = M[joints * i + i] * v[i] - h * bias[i], was = new[i].v;
          for (long j = 0; j < joints; j++)
            if (j != i) b -= M[joints * i + j] * (new[j].v - v[j]);
          solve(state + i, drives + i * PARAMETERS, M[joints * i + i], b, h, new + i, motor + i);
          change = most(change, fabs(new[i].v - was));
        }
        if (change <= tolerance) break;
      }
      for (long i = 0; i < joints; i++)
        finish(state + i, new[i], motor[i], 0.5 * drives[i * PARAMETERS + PLAY], h);
    }
    for (long i = 0; i < joints; i++) position[(n + 1) * joints + i] = state[i].r;
  }
}

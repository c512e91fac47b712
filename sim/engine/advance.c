/* Machines through one interval between demands; compiled where there is a compiler.

   A step is to rounding that of MuJoCo's mj_step for the models of `_models.py`: a fourth-order
   Runge-Kutta step of links and rotors. MuJoCo computes the links' mass matrix and bias forces, a
   sixth of the instructions of mj_step with every disturbance. Half of the others are for
   constraints of any kind; here, friction acts on one degree of freedom at a time. The remaining
   are for rotors as bodies, tendons, actuators, and what the models do not have. */

#include <math.h>
#include <string.h>

#include <mujoco/mjdata.h>
#include <mujoco/mjmodel.h>

typedef void (*Stage)(const mjModel *, mjData *);
typedef void (*Recursion)(const mjModel *, mjData *, int, mjtNum *);

/* `_Group` of `_compiled_steps.py`. Arrays have a row of dofs, joints or steps a machine. */
typedef struct {
  Stage kinematics, com_pos, inertia, com_vel; /* MuJoCo's functions of these names */
  Recursion rne;
  long machines, joints, dofs, steps;
  double step;
  const long *rotor; /* (joints,): each joint's rotor among degrees of freedom */
  const mjModel *const *models;
  double *state; /* MuJoCo's rows of a state */
  long row, position, velocity, warmstart; /* their length, and where these parts begin */
  const double *viscous, *dry, *static_loss, *gamma, *asymmetry; /* dofs: fields of `Friction` */
  const double *stale; /* steps */
  const double *before, *torque; /* joints: of the drives, for the previous and present demand */
  const double *acceleration; /* dofs: at the beginning */
  long next; /* the first machine that no thread has taken */
} Group;

/* MuJoCo's friction constraint of one degree of freedom. With x = a - aref its force is
   -x / R, at most `loss` either way; aref = -B qd, which would stop it within a step. */
typedef struct {
  double loss, stiffness, damping; /* stiffness: 1 / R */
} Friction;

typedef struct {
  const Group *group;
  const mjModel *whole, *links; /* with rotors, and without */
  mjData *data;
  const Friction *friction; /* (dofs,) */
  const double *force;      /* (dofs,): applied */
  int *limits;              /* (joints,): as `limit` of each link's friction, at the latest state */
} Machine;

static double least(double a, double b) { return a < b ? a : b; }
static double most(double a, double b) { return a > b ? a : b; }

/* As mj_makeImpedance and mj_referenceConstraint. */
static Friction friction_of(const mjModel *m, long dof) {
  const mjtNum *ref = m->dof_solref + mjNREF * dof, *imp = m->dof_solimp + mjNIMP * dof;
  double impedance = least(mjMAXIMP, most(mjMINIMP, 0.5 * (imp[0] + imp[1])));
  double time = most(ref[0], 2 * m->opt.timestep);
  double R = most(mjMINVAL, (1 - impedance) / impedance * m->dof_invweight0[dof]);
  double loss = m->dof_frictionloss[dof]; /* without friction the limit always holds */
  return (Friction){loss, loss > 0 ? 1 / R : 0, 2 / most(mjMINVAL, impedance * time)};
}

/* Sign of x where friction is at its limit, otherwise 0. */
static int limit(Friction c, double x) {
  return c.stiffness * x >= c.loss ? 1 : c.stiffness * x <= -c.loss ? -1 : 0;
}

static double pull(Friction c, double x) {
  return most(-c.loss, least(c.loss, -c.stiffness * x));
}

/* x from A x = b, A (n, n) symmetric, its lower triangle used up. */
static void solve(long n, double A[n][n], double *x) {
  for (long j = 0; j < n; j++) { /* A = L D L', rows of L below the diagonal, 1 / D on it */
    double scaled[n];
    double pivot = A[j][j];
    for (long k = 0; k < j; k++) {
      scaled[k] = A[j][k];
      A[j][k] *= A[k][k];
      pivot -= scaled[k] * A[j][k];
    }
    A[j][j] = 1 / pivot;
    for (long i = j + 1; i < n; i++)
      for (long k = 0; k < j; k++) A[i][j] -= A[i][k] * A[j][k];
  }
  for (long i = 0; i < n; i++)
    for (long k = 0; k < i; k++) x[i] -= A[i][k] * x[k];
  for (long i = 0; i < n; i++) x[i] *= A[i][i];
  for (long i = n - 1; i >= 0; i--)
    for (long k = i + 1; k < n; k++) x[i] -= A[k][i] * x[k];
}

/* Accelerations of the links: M a = force + friction, whose solution is the minimum of a convex
   function, quadratic between the limits of friction. Newton's method from those limits that held
   before; where a step overshoots, the minimum on its line, which bisection looks for. */
static void accelerate(long n, double M[n][n], const double *force, const double *target,
                       const Friction *c, int *limits, double *a) {
  double A[n][n], tried[n];
  for (int iteration = 0; iteration < 50; iteration++) {
    memcpy(A, M, sizeof A);
    for (long i = 0; i < n; i++) {
      tried[i] = force[i];
      if (limits[i]) {
        tried[i] -= limits[i] * c[i].loss;
      } else {
        A[i][i] += c[i].stiffness;
        tried[i] += c[i].stiffness * target[i];
      }
    }
    solve(n, A, tried);
    int changed = 0;
    double gradient = 0, shift[n], curvature = 0, slope = 0;
    for (long i = 0; i < n; i++) changed |= limit(c[i], tried[i] - target[i]) != limits[i];
    if (!changed) break;
    if (iteration > 0) {
      for (long i = 0; i < n; i++) shift[i] = tried[i] - a[i];
      for (long i = 0; i < n; i++) {
        double inertia_shift = 0, inertia_force = -force[i];
        for (long k = 0; k < n; k++) {
          double m = k < i ? M[i][k] : M[k][i];
          inertia_shift += m * shift[k];
          inertia_force += m * a[k];
        }
        slope += shift[i] * inertia_force;
        curvature += shift[i] * inertia_shift;
        gradient -= shift[i] * pull(c[i], tried[i] - target[i]);
      }
      if (slope + curvature + gradient > 0) {
        double low = 0, high = 1;
        for (int halving = 0; halving < 50; halving++) {
          double share = 0.5 * (low + high);
          gradient = slope + share * curvature;
          for (long i = 0; i < n; i++)
            gradient -= shift[i] * pull(c[i], a[i] + share * shift[i] - target[i]);
          if (gradient > 0) high = share; else low = share;
        }
        for (long i = 0; i < n; i++) tried[i] = a[i] + high * shift[i];
      }
    }
    for (long i = 0; i < n; i++) {
      a[i] = tried[i];
      limits[i] = limit(c[i], a[i] - target[i]);
    }
  }
  memcpy(a, tried, sizeof tried);
}

/* Accelerations of links and rotors at a state. */
static void evaluate(const Machine *machine, const double *q, const double *qd, double *a) {
  const Group *g = machine->group;
  const mjModel *m = machine->links, *whole = machine->whole;
  mjData *d = machine->data;
  long n = g->joints;
  double force[g->dofs], target[g->dofs], bias[n];
  memcpy(d->qpos, q, n * sizeof *q);
  memcpy(d->qvel, qd, n * sizeof *qd);
  g->kinematics(m, d);
  g->com_pos(m, d);
  g->inertia(m, d);
  g->com_vel(m, d);
  g->rne(m, d, 0, bias);
  for (long i = 0; i < g->dofs; i++) {
    force[i] = machine->force[i] - whole->dof_damping[i] * qd[i];
    target[i] = -machine->friction[i].damping * qd[i];
  }
  for (long i = 0; i < n; i++) {
    force[i] -= bias[i];
    long rotor = g->rotor[i], tendon = rotor - n;
    if (tendon < 0) continue;
    const mjtNum *slack = whole->tendon_lengthspring + 2 * tendon;
    double twist = q[rotor] - q[i];
    double spring = twist > slack[1] ? slack[1] - twist : twist < slack[0] ? slack[0] - twist : 0;
    double transmitted = -whole->tendon_stiffness[tendon] * spring +
                         whole->tendon_damping[tendon] * (qd[rotor] - qd[i]);
    force[rotor] -= transmitted;
    force[i] += transmitted;
    /* A rotor is a body of its own. */
    Friction c = machine->friction[rotor];
    double inertia = whole->dof_M0[rotor];
    a[rotor] = (force[rotor] + c.stiffness * target[rotor]) / (inertia + c.stiffness);
    int slides = limit(c, a[rotor] - target[rotor]);
    if (slides) a[rotor] = (force[rotor] - slides * c.loss) / inertia;
  }
  double M[n][n];
  memset(M, 0, sizeof M);
  for (long i = 0; i < n; i++)
    for (int k = m->M_rowadr[i]; k < m->M_rowadr[i] + m->M_rownnz[i]; k++)
      M[i][m->M_colind[k]] = d->M[k];
  accelerate(n, M, force, target, machine->friction, machine->limits, a);
}

/* One step of the fourth-order Runge-Kutta method, with constant applied forces. */
static void runge_kutta(const Machine *machine, double *q, double *qd) {
  static const double part[3] = {0.5, 0.5, 1}, weight[4] = {1. / 6, 1. / 3, 1. / 3, 1. / 6};
  long dofs = machine->group->dofs;
  double h = machine->group->step;
  double a[dofs], q_i[dofs], qd_i[dofs], dq[dofs], dqd[dofs];
  memcpy(q_i, q, sizeof q_i);
  memcpy(qd_i, qd, sizeof qd_i);
  memset(dq, 0, sizeof dq);
  memset(dqd, 0, sizeof dqd);
  for (int stage = 0; stage < 4; stage++) {
    evaluate(machine, q_i, qd_i, a);
    for (long i = 0; i < dofs; i++) {
      dq[i] += weight[stage] * qd_i[i];
      dqd[i] += weight[stage] * a[i];
      if (stage == 3) continue;
      q_i[i] = q[i] + h * part[stage] * qd_i[i];
      qd_i[i] = qd[i] + h * part[stage] * a[i];
    }
  }
  for (long i = 0; i < dofs; i++) {
    q[i] += h * dq[i];
    qd[i] += h * dqd[i];
  }
}

/* By how much friction falls short of its constant part: `Friction.help`. */
static double help(const Group *g, long at, double qd) {
  double speed = fabs(qd), excess = g->static_loss[at] - g->dry[at];
  double weaker = excess > 0 ? -excess * expm1(-speed / g->gamma[at]) : 0;
  double one_sided = g->viscous[at] * speed + g->static_loss[at] - weaker;
  return (qd > 0 ? weaker : -weaker) - g->asymmetry[at] * one_sided;
}

static void advance_machine(const Group *g, long which, mjData *data) {
  long n = g->joints, dofs = g->dofs;
  const mjModel *whole = g->models[which];
  mjModel links = *whole; /* rotors are the last bodies */
  links.nbody = n + 1;
  links.nq = links.nv = links.njnt = n;
  Friction friction[dofs];
  int limits[n];
  double force[dofs], before[dofs], acceleration[dofs];
  double *q = g->state + which * g->row + g->position;
  double *qd = g->state + which * g->row + g->velocity;
  Machine machine = {g, whole, &links, data, friction, force, limits};
  for (long i = 0; i < dofs; i++) {
    friction[i] = friction_of(whole, i);
    acceleration[i] = g->acceleration[which * dofs + i];
  }
  for (long i = 0; i < n; i++)
    limits[i] = limit(friction[i], acceleration[i] + friction[i].damping * qd[i]);
  for (long step = 0; step < g->steps; step++) {
    double stale = g->stale[which * g->steps + step];
    for (long i = 0; i < dofs; i++)
      force[i] = help(g, which * dofs + i, qd[i] + 0.5 * g->step * acceleration[i]);
    for (long i = 0; i < n; i++)
      force[g->rotor[i]] +=
          stale * g->before[which * n + i] + (1 - stale) * g->torque[which * n + i];
    memcpy(before, qd, sizeof before);
    runge_kutta(&machine, q, qd);
    for (long i = 0; i < dofs; i++) acceleration[i] = (qd[i] - before[i]) / g->step;
  }
  memcpy(g->state + which * g->row + g->warmstart, acceleration, sizeof acceleration);
}

/* Takes machines until none is left; threads with data of their own share them out. */
void advance(Group *group, mjData *data) {
  for (;;) {
    long which = __atomic_fetch_add(&group->next, 1, __ATOMIC_RELAXED);
    if (which >= group->machines) return;
    advance_machine(group, which, data);
  }
}

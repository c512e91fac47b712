/* A whole arm; read with `_simulation.py`, which puts the equations of its links above this text:

       static void rigid_bodies(const double *body, const double *q, const double *qd,
                                const double *qdd, double *torque, double *mass)

   and those of its drives, `joint.c`. */

/* Part of its depth by which a point below the table rises in a step. */
static const double PUSHED_OUT = 0.2;

/* Torques (samples, joints) of motions, and mass matrices (samples, joints, joints). */
void inverse_dynamics(const double *body, const double *q, const double *v, const double *a,
                      double *torque, double *mass, long samples, long joints) {
  for (long n = 0; n < samples; n++)
    rigid_bodies(body, q + n * joints, v + n * joints, a + n * joints, torque + n * joints,
                 mass + n * joints * joints);
}

/* Most that the height of a point can fall per impulse that holds it, with `rise` its derivatives:
   servos feel their armature and damping, links within the play of a gear their own inertia. */
static double yielding(const double *rise, const double *drives, const double *M, long joints,
                       double h) {
  double sum = 0.0;
  for (long i = 0; i < joints; i++) {
    const double *p = drives + i * PARAMETERS;
    double servo = p[ARMATURE] + 0.5 * h * p[DAMPING], links = M[joints * i + i];
    sum += rise[i] * rise[i] / (p[PLAY] > 0.0 ? 0.5 * least(servo, links) : servo);
  }
  return sum;
}

/* Joints are coupled by the mass matrix; a step solves them in turn until no velocity
   changes by more than `tolerance` (Gauss and Seidel: the matrix is positive definite).

   A point that is `height` above a table does not go below: an impulse `press` holds it, which is
   raised and lowered in the same turns (Uzawa). `point` is a body whose gravity torques are the
   derivatives of the height. Without a table the height is infinite. */
void simulate_arm(const double *body, const double *drives, const double *time,
                  const double *command, const double *sum, const double *start,
                  const double *point, double height, double *position, long samples, long joints,
                  long substeps, long sweeps, double tolerance) {
  Joint state[joints];
  Command commands[joints];
  double q[joints], v[joints], zero[joints], bias[joints], M[joints * joints], before[joints];
  double rise[joints], unused[joints * joints], press = 0.0;
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
  rigid_bodies(body, q, zero, zero, bias, M);
  for (long i = 0; i < joints; i++) state[i].gap = flank(drives + i * PARAMETERS, bias[i]);
  for (long n = 0; n + 1 < samples; n++) {
    double h = (time[n + 1] - time[n]) / substeps;
    for (long k = 0; k < substeps; k++) {
      for (long i = 0; i < joints; i++) {
        q[i] = state[i].r - drives[i * PARAMETERS + OFFSET];
        v[i] = state[i].v;
      }
      rigid_bodies(body, q, v, zero, bias, M);
      for (long i = 0; i < joints; i++) {
        const double *p = drives + i * PARAMETERS;
        double after = integral(commands + i, time[n] + (k + 1) * h - p[DELAY]);
        begin(state + i, p, (after - before[i]) / h, p[LEAD] > 0.0 ? slope(commands + i) : 0.0,
              bias[i], h);
        before[i] = after;
        new[i] = (Step){v[i], v[i]};
      }
      double fall = 0.0, down = 0.0;
      if (isfinite(height)) {
        rigid_bodies(point, q, zero, zero, rise, unused);
        fall = yielding(rise, drives, M, joints, h);
        down = (height > 0.0 ? height : PUSHED_OUT * height) / h;
      }
      for (long sweep = 0; sweep < sweeps; sweep++) {
        double change = 0.0;
        for (long i = 0; i < joints; i++) {
          double b = M[joints * i + i] * v[i] - h * bias[i], was = new[i].v;
          for (long j = 0; j < joints; j++)
            if (j != i) b -= M[joints * i + j] * (new[j].v - v[j]);
          if (fall > 0.0) b += rise[i] * press;
          solve(state + i, drives + i * PARAMETERS, M[joints * i + i], b, h, new + i, motor + i);
          change = most(change, fabs(new[i].v - was));
        }
        if (fall > 0.0) {
          double rising = down, was = press;
          for (long i = 0; i < joints; i++) rising += rise[i] * new[i].v;
          press = most(0.0, press - rising / fall);
          change = most(change, fall * fabs(press - was));
        }
        if (change <= tolerance) break;
      }
      for (long i = 0; i < joints; i++)
        finish(state + i, new[i], motor[i], 0.5 * drives[i * PARAMETERS + PLAY], h);
      if (fall > 0.0)
        for (long i = 0; i < joints; i++) height += h * rise[i] * new[i].mean;
    }
    for (long i = 0; i < joints; i++) position[(n + 1) * joints + i] = state[i].r;
  }
}

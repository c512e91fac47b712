/* A whole arm; read with `_simulation.py`, which puts the equations of its links above this text:

       static void rigid_bodies(const double *body, const double *q, const double *qd,
                                const double *qdd, double *torque, double *mass)

   and those of its drives, `joint.c`. */

/* Torques (samples, joints) of motions, and mass matrices (samples, joints, joints). */
void inverse_dynamics(const double *body, const double *q, const double *v, const double *a,
                      double *torque, double *mass, long samples, long joints) {
  for (long n = 0; n < samples; n++)
    rigid_bodies(body, q + n * joints, v + n * joints, a + n * joints, torque + n * joints,
                 mass + n * joints * joints);
}

/* Joints are coupled by the mass matrix; a step solves them in turn until no velocity
   changes by more than `tolerance` (Gauss and Seidel: the matrix is positive definite). */
void simulate_arm(const double *body, const double *drives, const double *time,
                  const double *command, const double *sum, const double *start, double *position,
                  long samples, long joints, long substeps, long sweeps, double tolerance) {
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

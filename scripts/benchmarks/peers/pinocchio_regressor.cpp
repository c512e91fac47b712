/* Pinocchio's joint torque regressor on threads.

   MODEL THREADS SAMPLES: prints the seconds that they take, and a sum of entries. */

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <thread>
#include <vector>

#include <pinocchio/algorithm/regressor.hpp>
#include <pinocchio/serialization.hpp>

int main(int argc, char** argv)
{
    if (argc != 4)
        return 2;
    pinocchio::Model model;
    pinocchio::serialization::loadFromBinary(model, argv[1]);
    const int threads = std::atoi(argv[2]);
    const long samples = std::atol(argv[3]);
    std::vector<double> sums(threads, 0.0);
    std::vector<std::thread> pool;
    const auto start = std::chrono::steady_clock::now();
    for (int thread = 0; thread < threads; ++thread)
        pool.emplace_back([&model, &sums, thread, threads, samples] {
            pinocchio::Data data(model);
            Eigen::VectorXd q = Eigen::VectorXd::Constant(model.nv, 0.3);
            const Eigen::VectorXd qd = Eigen::VectorXd::Constant(model.nv, -0.7);
            const Eigen::VectorXd qdd = Eigen::VectorXd::Constant(model.nv, 1.1);
            double sum = 0.0;
            for (long i = thread; i < samples; i += threads) {
                q.array() += 1e-6; /* another state each time */
                pinocchio::computeJointTorqueRegressor(model, data, q, qd, qdd);
                sum += data.jointTorqueRegressor(0, 5);
            }
            sums[thread] = sum;
        });
    for (auto& worker : pool)
        worker.join();
    const std::chrono::duration<double> seconds = std::chrono::steady_clock::now() - start;
    double total = 0.0;
    for (double sum : sums)
        total += sum;
    std::printf("%.9g %.17g\n", seconds.count(), total);
    return 0;
}

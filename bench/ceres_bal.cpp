// Ceres on a problem of "Bundle adjustment in the large", for bench/ba.py.
//
//   g++ -O3 -march=native -std=c++17 -I/usr/include/eigen3 bench/ceres_bal.cpp -o ceres_bal
//       -lceres -lglog
//   ceres_bal PROBLEM.txt THREADS dense|sparse|iterative ITERATIONS ADJUSTED.txt analytic|automatic
//
// Prints "seconds cost" after the set-up and after every step, and writes the adjusted problem.
// Derivatives are analytic, as ours are, so that automatic differentiation is no part of the
// comparison; or automatic, as in Ceres' bundle_adjuster.
#include <ceres/ceres.h>
#include <ceres/rotation.h>

#include <cstdio>
#include <cstdlib>
#include <string>
#include <vector>

namespace {

// The projection of snavely.rs, with the camera as angle-axis, translation, f, k1, k2.
class Snavely : public ceres::SizedCostFunction<2, 9, 3> {
 public:
  Snavely(double x, double y) : x_(x), y_(y) {}

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    const double* camera = parameters[0];
    const double* point = parameters[1];
    double rotated[3];
    double d_rotated[9];  // by the angle-axis, row by row
    double rotation[9];   // column by column
    ceres::AngleAxisToRotationMatrix(camera, rotation);
    for (int i = 0; i < 3; ++i) {
      rotated[i] = rotation[i] * point[0] + rotation[3 + i] * point[1] + rotation[6 + i] * point[2];
    }
    const double p[3] = {rotated[0] + camera[3], rotated[1] + camera[4], rotated[2] + camera[5]};
    const double inv = -1.0 / p[2];
    const double u = p[0] * inv, v = p[1] * inv;
    const double f = camera[6], k1 = camera[7], k2 = camera[8];
    const double s = u * u + v * v;
    const double distortion = 1.0 + s * (k1 + k2 * s);
    residuals[0] = f * distortion * u - x_;
    residuals[1] = f * distortion * v - y_;
    if (jacobians == nullptr) return true;

    const double slope = 2.0 * (k1 + 2.0 * k2 * s);
    const double a = f * (distortion + slope * u * u) * inv, b = f * slope * u * v * inv,
                 c = f * (distortion + slope * v * v) * inv;
    const double d_p[6] = {a, b, a * u + b * v, b, c, b * u + c * v};
    if (jacobians[0] != nullptr) {
      // d (R p) / d w = -[R p]x J_l(w), J_l the left Jacobian of the rotation group.
      double left[9];
      LeftJacobian(camera, left);
      const double minus_hat[9] = {
          0, rotated[2], -rotated[1], -rotated[2], 0, rotated[0], rotated[1], -rotated[0], 0};
      for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
          d_rotated[3 * i + j] = 0;
          for (int k = 0; k < 3; ++k)
            d_rotated[3 * i + j] += minus_hat[3 * i + k] * left[3 * k + j];
        }
      }
      for (int r = 0; r < 2; ++r) {
        double* row = jacobians[0] + 9 * r;
        for (int j = 0; j < 3; ++j) {
          row[j] = 0;
          for (int k = 0; k < 3; ++k) row[j] += d_p[3 * r + k] * d_rotated[3 * k + j];
          row[3 + j] = d_p[3 * r + j];
        }
        const double n = r == 0 ? u : v;
        row[6] = distortion * n;
        row[7] = f * s * n;
        row[8] = f * s * s * n;
      }
    }
    if (jacobians[1] != nullptr) {
      for (int r = 0; r < 2; ++r) {
        for (int j = 0; j < 3; ++j) {
          jacobians[1][3 * r + j] = d_p[3 * r] * rotation[3 * j] +
                                    d_p[3 * r + 1] * rotation[3 * j + 1] +
                                    d_p[3 * r + 2] * rotation[3 * j + 2];
        }
      }
    }
    return true;
  }

 private:
  static void LeftJacobian(const double* w, double* left) {
    const double t2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2];
    double a, b, c;  // cos-like, sin-like and dyadic parts: a I + b [w]x + c w wT
    if (t2 > 1e-8) {
      const double t = std::sqrt(t2);
      a = std::sin(t) / t;
      b = (1 - std::cos(t)) / t2;
      c = (1 - a) / t2;
    } else {
      a = 1 - t2 / 6;
      b = 0.5 - t2 / 24;
      c = 1.0 / 6 - t2 / 120;
    }
    const double hat[9] = {0, -w[2], w[1], w[2], 0, -w[0], -w[1], w[0], 0};
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j)
        left[3 * i + j] = (i == j ? a : 0) + b * hat[3 * i + j] + c * w[i] * w[j];
    }
  }

  double x_, y_;
};

// The same for automatic differentiation.
struct SnavelyAutomatic {
  double x, y;
  template <typename T>
  bool operator()(const T* camera, const T* point, T* residuals) const {
    T p[3];
    ceres::AngleAxisRotatePoint(camera, point, p);
    const T u = -(p[0] + camera[3]) / (p[2] + camera[5]),
            v = -(p[1] + camera[4]) / (p[2] + camera[5]);
    const T s = u * u + v * v;
    const T scale = camera[6] * (1.0 + s * (camera[7] + camera[8] * s));
    residuals[0] = scale * u - x;
    residuals[1] = scale * v - y;
    return true;
  }
};

}  // namespace

int main(int argc, char** argv) {
  if (argc != 7) return 2;
  FILE* file = std::fopen(argv[1], "r");
  int num_cameras, num_points, num_observations;
  if (file == nullptr ||
      std::fscanf(file, "%d %d %d", &num_cameras, &num_points, &num_observations) != 3)
    return 1;
  std::vector<int> camera(num_observations), point(num_observations);
  std::vector<double> pixels(2 * num_observations), x(9 * num_cameras + 3 * num_points);
  for (int i = 0; i < num_observations; ++i) {
    if (std::fscanf(file, "%d %d %lf %lf", &camera[i], &point[i], &pixels[2 * i],
                    &pixels[2 * i + 1]) != 4)
      return 1;
  }
  for (double& number : x) {
    if (std::fscanf(file, "%lf", &number) != 1) return 1;
  }
  std::fclose(file);

  ceres::Problem::Options problem_options;
  problem_options.disable_all_safety_checks = true;
  ceres::Problem problem(problem_options);
  double* points = x.data() + 9 * num_cameras;
  auto* ordering = new ceres::ParameterBlockOrdering;
  for (int i = 0; i < num_observations; ++i) {
    ceres::CostFunction* cost = nullptr;
    if (std::string(argv[6]) == "analytic") {
      cost = new Snavely(pixels[2 * i], pixels[2 * i + 1]);
    } else {
      cost = new ceres::AutoDiffCostFunction<SnavelyAutomatic, 2, 9, 3>(
          new SnavelyAutomatic{pixels[2 * i], pixels[2 * i + 1]});
    }
    problem.AddResidualBlock(cost, nullptr, x.data() + 9 * camera[i], points + 3 * point[i]);
  }
  for (int i = 0; i < num_points; ++i) ordering->AddElementToGroup(points + 3 * i, 0);
  for (int i = 0; i < num_cameras; ++i) ordering->AddElementToGroup(x.data() + 9 * i, 1);

  ceres::Solver::Options options;
  options.linear_solver_ordering.reset(ordering);
  const std::string solver = argv[3];
  options.linear_solver_type = solver == "dense"    ? ceres::DENSE_SCHUR
                               : solver == "sparse" ? ceres::SPARSE_SCHUR
                                                    : ceres::ITERATIVE_SCHUR;
  options.preconditioner_type = ceres::SCHUR_JACOBI;
  options.num_threads = std::atoi(argv[2]);
  options.max_num_iterations = std::atoi(argv[4]);
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  for (const auto& it : summary.iterations) {
    std::printf("%.6f %.9e\n", summary.preprocessor_time_in_seconds + it.cumulative_time_in_seconds,
                it.cost);
  }

  file = std::fopen(argv[5], "w");
  if (file == nullptr) return 1;
  std::fprintf(file, "%d %d %d\n", num_cameras, num_points, num_observations);
  for (int i = 0; i < num_observations; ++i) {
    std::fprintf(file, "%d %d %.17g %.17g\n", camera[i], point[i], pixels[2 * i],
                 pixels[2 * i + 1]);
  }
  for (double number : x) std::fprintf(file, "%.17g\n", number);
  std::fclose(file);
}

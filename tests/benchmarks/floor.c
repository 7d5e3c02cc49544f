/* Bare floor: RK4 of one Kirchhoff rod under a dead tip force with its sensitivities, 24 doubles, no frame, no position.
   cc -O3 -march=native -ffast-math floor.c -o floor; ./floor STEPS REPEATS prints microseconds per integration. */
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

static inline void cross(const double *a, const double *b, double *r) {
    r[0] = a[1] * b[2] - a[2] * b[1];
    r[1] = a[2] * b[0] - a[0] * b[2];
    r[2] = a[0] * b[1] - a[1] * b[0];
}

/* y: u, R^T F, then columns d/du(0) of both */
static inline void rates(const double *restrict y, double *restrict d, const double *K, const double *Ki, const double *us) {
    const double *u = y, *f = y + 3;
    double m[3], c[3];
    for (int i = 0; i < 3; i++) m[i] = K[i] * (u[i] - us[i]);
    cross(u, m, c);
    c[0] -= f[1];
    c[1] += f[0];
    for (int i = 0; i < 3; i++) d[i] = -Ki[i] * c[i];
    cross(f, u, d + 3);
    for (int j = 0; j < 3; j++) {
        const double *g = y + 6 + 3 * j, *x = y + 15 + 3 * j;
        double a[3], b[3], kg[3];
        for (int i = 0; i < 3; i++) kg[i] = K[i] * g[i];
        cross(m, g, a);
        cross(u, kg, b);
        a[0] -= b[0] - x[1];
        a[1] -= b[1] + x[0];
        a[2] -= b[2];
        for (int i = 0; i < 3; i++) d[6 + 3 * j + i] = Ki[i] * a[i];
        cross(f, g, a);
        cross(u, x, b);
        for (int i = 0; i < 3; i++) d[15 + 3 * j + i] = a[i] - b[i];
    }
}

__attribute__((noinline)) void integrate(double *y, double L, int steps, const double *K, const double *us) {
    double Ki[3] = {1 / K[0], 1 / K[1], 1 / K[2]}, h = L / steps, a[24], b[24], c[24], d[24], t[24];
    for (int n = 0; n < steps; n++) {
        rates(y, a, K, Ki, us);
        for (int i = 0; i < 24; i++) t[i] = y[i] + .5 * h * a[i];
        rates(t, b, K, Ki, us);
        for (int i = 0; i < 24; i++) t[i] = y[i] + .5 * h * b[i];
        rates(t, c, K, Ki, us);
        for (int i = 0; i < 24; i++) t[i] = y[i] + h * c[i];
        rates(t, d, K, Ki, us);
        for (int i = 0; i < 24; i++) y[i] += h / 6 * (a[i] + 2 * (b[i] + c[i]) + d[i]);
    }
}

int main(int argc, char **argv) {
    int steps = argc > 1 ? atoi(argv[1]) : 50, count = argc > 2 ? atoi(argv[2]) : 20000;
    double K[3] = {.223349, .223349, .063814}, us[3] = {14, 5, 0}, sum = 0, best = 1e9;
    for (int r = 0; r < 5; r++) {
        struct timespec p, q;
        clock_gettime(CLOCK_MONOTONIC, &p);
        for (int k = 0; k < count; k++) {
            double y[24] = {14 + k * 1e-5, 5, 0, 1, 0, .5};
            y[6] = y[10] = y[14] = 1;
            integrate(y, .4, steps, K, us);
            sum += y[0];
        }
        clock_gettime(CLOCK_MONOTONIC, &q);
        double t = ((q.tv_sec - p.tv_sec) + 1e-9 * (q.tv_nsec - p.tv_nsec)) / count * 1e6;
        if (t < best) best = t;
    }
    printf("%.4f %g\n", best, sum);
    return 0;
}

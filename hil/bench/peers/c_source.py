"""Four-volume loop in plain C, as a programmer would write it for this one job. It fits no other network.

dT/dt of heater, modules, radiator, tank with the numbers of `C_PARAMETERS`; one Taylor step of order `ORDER` a
second, which for a linear system of order 4 is classical Runge-Kutta. `LANES` particles advance together in vector
registers; with LANES = 1 it is ordinary scalar C. The exponents of the fan law are those of the first particle.
"""

from __future__ import annotations

C_PARAMETERS = (
    "heater.capacitance",
    "modules.capacitance",
    "radiator.capacitance",
    "tank.capacitance",
    "circuit.nominal",
    "circuit.factor",
    "circuit.cp",
    "circuit.effectiveness_modules",
    "heater_to_modules.resistance",
    "modules_to_radiator.resistance",
    "radiator_to_tank.resistance",
    "heater_loss.hA",
    "modules_loss.hA",
    "tank_loss.hA",
    "fins.UA_100",
    "fins.fan_exponent",
    "fins.flow_exponent",
    "fins.UA_still",
    "heater_power.factor",
    "modules_power.power",
)
"""Order of a particle's numbers."""
C_INPUTS = ("heater_power_W", "pump_speed_pct", "fan_speed_pct", "T_ambient_C")

C_SOURCE = r"""
#include <math.h>
#include <stdlib.h>
#include <string.h>
#define P 20
typedef double v __attribute__((vector_size(8 * WIDTH)));
#define EACH for (int g = 0; g < LANES / WIDTH; g++)

static void load(v *out, const double *particles, long count, long first, int column) {
    double lane[LANES];
    for (int l = 0; l < LANES; l++) {
        long i = first + l < count ? first + l : count - 1;
        lane[l] = particles[i * P + column];
    }
    memcpy(out, lane, sizeof lane);
}

void cost(const double *particles, long count, const double *start, const double *inputs, const double *measured,
          const double *weight, long n, double *total, double *states) {
    double *pump = malloc(n * sizeof *pump), *fan = malloc(n * sizeof *fan);
    for (long i = 0; i < n; i++) {
        const double *u = inputs + 4 * i;
        if (i && u[1] == u[-3] && u[2] == u[-2]) { pump[i] = pump[i - 1]; fan[i] = fan[i - 1]; continue; }
        double lf = log((u[2] > 0.1 ? u[2] : 0.1) * 0.01), lp = log((u[1] > 0.1 ? u[1] : 0.1) * 0.01);
        pump[i] = u[1] > 0.0 ? u[1] * 0.01 : 0.0;
        fan[i] = exp(particles[15] * lf + particles[16] * lp);
    }
    for (long first = 0; first < count; first += LANES) {
        v p[P][LANES / WIDTH], x[4][LANES / WIDTH], sum[LANES / WIDTH], mcp[LANES / WIDTH], ua[LANES / WIDTH];
        v gh[LANES / WIDTH], gm[LANES / WIDTH], gr[LANES / WIDTH], c[4][LANES / WIDTH];
        for (int j = 0; j < P; j++) load(p[j], particles, count, first, j);
        EACH {
            for (int j = 0; j < 4; j++) { x[j][g] = start[j] - (v){0}; c[j][g] = 1.0 / p[j][g]; }
            gh[g] = 1.0 / p[8][g]; gm[g] = 1.0 / p[9][g]; gr[g] = 1.0 / p[10][g];
            sum[g] = (v){0};
        }
        for (long i = 0; i < n; i++) {
            const double *u = inputs + 4 * i, *y = measured + 4 * i, *w = weight + 4 * i;
            if (states) for (int j = 0; j < 4; j++) states[4 * i + j] = x[j][0][0];
            EACH {
                v r0 = (x[0][g] - y[0]) * w[0], r1 = (x[1][g] - y[1]) * w[1];
                v r2 = (x[2][g] - y[2]) * w[2], r3 = (x[3][g] - y[3]) * w[3];
                sum[g] += r0 * r0 + r1 * r1 + r2 * r2 + r3 * r3;
            }
            if (i == n - 1) break;
            if (i == 0 || pump[i] != pump[i - 1] || fan[i] != fan[i - 1]) EACH {
                mcp[g] = p[4][g] * (0.997 / 60.0) * p[5][g] * p[6][g] * pump[i];
                ua[g] = p[14][g] * fan[i] + p[17][g];
            }
            EACH {
                v x0 = x[0][g], x1 = x[1][g], x2 = x[2][g], x3 = x[3][g];
                v a0 = x0, a1 = x1, a2 = x2, a3 = x3, q = p[18][g] * u[0];
                for (int s = ORDER; s > 0; s--) {
                    double h = 1.0 / s;
                    v hm = gh[g] * (a0 - a1), mr = gm[g] * (a1 - a2), rt = gr[g] * (a2 - a3);
                    v gain = p[7][g] * (a0 - a1);
                    v f0 = mcp[g] * (a3 - a0) - hm + p[11][g] * (u[3] - a0) + q;
                    v f1 = mcp[g] * gain + hm - mr + p[12][g] * (u[3] - a1) + p[19][g];
                    v f2 = mcp[g] * (a0 - gain - a2) + mr - rt + ua[g] * (u[3] - a2);
                    v f3 = mcp[g] * (a2 - a3) + rt + p[13][g] * (u[3] - a3);
                    a0 = x0 + h * c[0][g] * f0; a1 = x1 + h * c[1][g] * f1;
                    a2 = x2 + h * c[2][g] * f2; a3 = x3 + h * c[3][g] * f3;
                }
                x[0][g] = a0; x[1][g] = a1; x[2][g] = a2; x[3][g] = a3;
            }
        }
        for (int l = 0; l < LANES && first + l < count; l++) total[first + l] = ((double *)sum)[l];
    }
    free(pump);
    free(fan);
}
"""

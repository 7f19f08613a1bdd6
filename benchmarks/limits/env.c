/* CartPole with auto-reset under a random policy, written so that the compiler makes vector code of it: an upper bound
   for any implementation on this machine. Physics as Gymnasium's CartPole-v1 in float32. An environment is one column
   of the arrays; BLOCK of them step together, all their steps before the next block's. */

#include <math.h>
#include <stdint.h>

#define BLOCK 64

/* Sine and cosine of a small angle: an episode ends at 0.21 rad. */
static inline float sine(float r) {
    float s = r * r;
    return r + r * s * (-1.6666654611e-1f + s * (8.3321608736e-3f - s * 1.9515295891e-4f));
}

static inline float cosine(float r) {
    float s = r * r;
    return 1 - 0.5f * s + s * s * (4.166664568e-2f - s * (1.388731625e-3f - s * 2.443315712e-5f));
}

/* Marsaglia's xorshift32; never 0 once it is not. */
static inline uint32_t next(uint32_t word) {
    word ^= word << 13;
    word ^= word >> 17;
    return word ^ (word << 5);
}

static inline float start(uint32_t word) { return (float)(int32_t)(word >> 8) * (0.1f / 16777216) - 0.05f; }

/* state: x, x_dot, theta, theta_dot as float32 and t, word as 32-bit integers, each [count]. Returns the episodes that
   ended. count is a multiple of BLOCK. */
int64_t env_steps(int64_t count, int64_t steps, float *restrict x, float *restrict x_dot, float *restrict theta,
                  float *restrict theta_dot, int32_t *restrict t, uint32_t *restrict word) {
    int64_t episodes = 0;
    for (int64_t first = 0; first < count; first += BLOCK) {
        int32_t ended[BLOCK] = {0};
        for (int64_t step = 0; step < steps; step++) {
#pragma GCC ivdep
            for (int64_t k = 0; k < BLOCK; k++) {
                int64_t i = first + k;
                uint32_t w = next(word[i]);
                float force = (w & 0x10000) ? 10.0f : -10.0f;
                float c = cosine(theta[i]), s = sine(theta[i]);
                float temp = (force + 0.05f * theta_dot[i] * theta_dot[i] * s) / 1.1f;
                float theta_acc = (9.8f * s - c * temp) / (0.5f * (4.0f / 3.0f - 0.1f * c * c / 1.1f));
                float x_acc = temp - 0.05f * theta_acc * c / 1.1f;
                float nx = x[i] + 0.02f * x_dot[i], nx_dot = x_dot[i] + 0.02f * x_acc;
                float ntheta = theta[i] + 0.02f * theta_dot[i], ntheta_dot = theta_dot[i] + 0.02f * theta_acc;
                int32_t nt = t[i] + 1;
                int over = (fabsf(nx) > 2.4f) | (fabsf(ntheta) > 0.20943951f) | (nt >= 500);
                uint32_t w1 = next(w), w2 = next(w1), w3 = next(w2);
                x[i] = over ? start(w) : nx;
                x_dot[i] = over ? start(w1) : nx_dot;
                theta[i] = over ? start(w2) : ntheta;
                theta_dot[i] = over ? start(w3) : ntheta_dot;
                t[i] = over ? 0 : nt;
                word[i] = w3;
                ended[k] += over;
            }
        }
        for (int64_t k = 0; k < BLOCK; k++) episodes += ended[k];
    }
    return episodes;
}

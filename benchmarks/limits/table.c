/* The tutorial's Q-learning on CartPole, one lane after the other in scalar code: what a careful C programmer writes.
   Settings and schedule of article-q; 6 x 3 buckets of the angle and its velocity, 2 actions. */

#include <math.h>
#include <stdint.h>

typedef struct {
    float q[36];
    float x, x_dot, theta, theta_dot;
    int32_t t, episode;
    uint64_t word;
} Lane;

static inline uint32_t draw(Lane *lane) { /* xorshift64* */
    lane->word ^= lane->word >> 12;
    lane->word ^= lane->word << 25;
    lane->word ^= lane->word >> 27;
    return (uint32_t)((lane->word * 2685821657736338717ull) >> 32);
}

static inline float unit(uint32_t word) { return (float)(word >> 8) * (1.0f / 16777216); }

static inline void reset(Lane *lane) {
    lane->x = unit(draw(lane)) * 0.1f - 0.05f;
    lane->x_dot = unit(draw(lane)) * 0.1f - 0.05f;
    lane->theta = unit(draw(lane)) * 0.1f - 0.05f;
    lane->theta_dot = unit(draw(lane)) * 0.1f - 0.05f;
    lane->t = 0;
}

static inline int bucket(float value, float bound, int count) {
    if (value <= -bound) return 0;
    if (value >= bound) return count - 1;
    return (int)lrintf((value + bound) * (float)(count - 1) / (2 * bound));
}

static inline int observe(const Lane *lane) {
    return bucket(lane->theta, 0.41887903f, 6) * 3 + bucket(lane->theta_dot, 0.87266463f, 3);
}

static inline float decay(int episode, float low, float high) {
    float value = 1 - log10f((float)(episode + 1) / 25);
    return value < low ? low : value > high ? high : value;
}

void table_init(int64_t count, Lane *lanes, uint64_t seed) {
    for (int64_t i = 0; i < count; i++) {
        Lane *lane = lanes + i;
        for (int k = 0; k < 36; k++) lane->q[k] = 0;
        lane->word = (seed + (uint64_t)i + 1) * 0x9E3779B97F4A7C15ull | 1;
        lane->episode = 0;
        reset(lane);
    }
}

/* Every lane makes this many updates. Returns the episodes that ended in all. */
int64_t table_updates(int64_t count, int64_t updates, Lane *lanes) {
    int64_t episodes = 0;
    for (int64_t i = 0; i < count; i++) {
        Lane lane = lanes[i];
        int s = observe(&lane);
        float alpha = decay(lane.episode, 0.1f, 0.5f), epsilon = decay(lane.episode, 0.01f, 1.0f);
        for (int64_t u = 0; u < updates; u++) {
            int a;
            if (unit(draw(&lane)) < epsilon) a = draw(&lane) >> 31;
            else a = lane.q[2 * s + 1] > lane.q[2 * s];
            float force = a ? 10.0f : -10.0f, sn = sinf(lane.theta), c = cosf(lane.theta);
            float temp = (force + 0.05f * lane.theta_dot * lane.theta_dot * sn) / 1.1f;
            float theta_acc = (9.8f * sn - c * temp) / (0.5f * (4.0f / 3.0f - 0.1f * c * c / 1.1f));
            float x_acc = temp - 0.05f * theta_acc * c / 1.1f;
            lane.x += 0.02f * lane.x_dot;
            lane.x_dot += 0.02f * x_acc;
            lane.theta += 0.02f * lane.theta_dot;
            lane.theta_dot += 0.02f * theta_acc;
            lane.t++;
            int over = fabsf(lane.x) > 2.4f || fabsf(lane.theta) > 0.20943951f || lane.t >= 500;
            int next = observe(&lane);
            float left = lane.q[2 * next], right = lane.q[2 * next + 1];
            float target = 1 + 0.99f * (left > right ? left : right);
            lane.q[2 * s + a] += alpha * (target - lane.q[2 * s + a]);
            s = next;
            if (over) {
                lane.episode++;
                episodes++;
                alpha = decay(lane.episode, 0.1f, 0.5f);
                epsilon = decay(lane.episode, 0.01f, 1.0f);
                reset(&lane);
                s = observe(&lane);
            }
        }
        lanes[i] = lane;
    }
    return episodes;
}

/* The controller. controller.h says how it is called; this file was made by `octopus export`. */

#include "controller.h"

#include <float.h>
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

/* ---- what this controller is ---- */

@SWITCHES@

/* Rows of a matrix. */
typedef struct {
    float row[3][3];
} matrix;

#if OCTOPUS_NEEDS_HANDS
/* From a link's frame to the next: a shift along x and z (m), and a twist about x, by a quarter turn or another one. */
typedef struct {
    int has_a, has_d, twist;
    float a, d, cosine, sine;
} link_type;

/* What arms of one type share: the first of their links in the table of all, and where the hand is in the last one. */
typedef struct {
    int first_link;
    float tool_position[3];
    matrix tool_rotation;
} kind_type;
#endif

#if OCTOPUS_NEEDS_ALGEBRA
/* Where an arm stands on the base, whence it sees, whether its hand has a goal, and how long it is, stretched (m). */
typedef struct {
    float position[3];
    matrix rotation;
    float axes[3][3];
    float home[OCTOPUS_ARM_JOINTS];
    int reaches, kind;
    float reach;
} arm_type;
#endif

/* Which joints of the robot are an arm's or an agent's. */
typedef struct {
    int first, n;
} joints_type;

/* The state and the goals in single precision. */
typedef struct {
    float base_position[3], base_attitude[4], base_velocity[3], base_angular_velocity[3];
    float joint_angles[OCTOPUS_JOINTS], joint_rates[OCTOPUS_JOINTS];
    matrix base_rotation;
#if OCTOPUS_TASK & OCTOPUS_TRAJECTORY
    float hand_goals[OCTOPUS_ARMS][6];
#endif
#if OCTOPUS_TASK & OCTOPUS_MOVING
    float hand_goal_velocities[OCTOPUS_ARMS][6];
#endif
#if OCTOPUS_TASK & OCTOPUS_REORIENTATION
    float base_goal[3];
#endif
} reading_type;

/* A layer of all actors. Rows that several actors share are stored once: actor a has row `..._row[a]`.
 * Weights are input after input; in bfloat16, the upper half of a float, where `half_weight` is given. */
typedef struct {
    size_t inputs, outputs;
    const float *weight;
    const uint16_t *half_weight;
    const unsigned char *weight_row;
    const float *bias;
    const unsigned char *bias_row;
#if OCTOPUS_HIDDEN_LAYER_NORM
    const float *gain;
    const unsigned char *gain_row;
    const float *shift;
    const unsigned char *shift_row;
#endif
} layer_type;

@TABLES@

/* ---- arithmetic: single precision, one rounding an operation, in the order of the simulator that trained ---- */

/* 16: only _Float16, which is not used here, is taken to more digits. */
#if FLT_EVAL_METHOD != 0 && FLT_EVAL_METHOD != 16
#error "Bits depend on single precision that stays single: compile for SSE (-mfpmath=sse), not for x87."
#endif
#if defined(__FAST_MATH__)
#error "Compile without -ffast-math: it changes bits, and lets NaN pass."
#endif
/* A product and a sum are two roundings, also where the processor has an instruction for both in one. */
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__)
#pragma GCC optimize ("fp-contract=off")
#endif

/* a b + c, and c - a b, with one rounding. */
static float fma_(float a, float b, float c) { return fmaf(a, b, c); }
static float fnma(float a, float b, float c) { return fmaf(-a, b, c); }

static float minimum(float a, float b) { return a < b ? a : b; }
static float maximum(float a, float b) { return a > b ? a : b; }
static float clamp(float x, float low, float high) { return minimum(maximum(x, low), high); }

static float from_bits(uint32_t bits)
{
    float x;
    memcpy(&x, &bits, sizeof x);
    return x;
}

static uint32_t to_bits(float x)
{
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    return bits;
}

static float absolute(float x) { return from_bits(to_bits(x) & 0x7fffffffu); }

#define F(x) ((float)(x))

static float horner(float x, const float *coefficients, size_t n)
{
    float y = coefficients[0];
    size_t i;
    for (i = 1; i < n; i++) y = fma_(y, x, coefficients[i]);
    return y;
}

/* Polynomials of the Cephes library (Moshier). */
#if OCTOPUS_NEEDS_ALGEBRA
static void sin_cos(float x, float *sin_x, float *cos_x)
{
    static const float S[] = {F(-1.9515295891e-4), F(8.3321608736e-3), F(-1.6666654611e-1)};
    static const float C[] = {F(2.443315711809948e-5), F(-1.388731625493765e-3), F(4.166664568298827e-2)};
    float j = rintf(x * F(0.63661977236758134308));
    float r = fnma(j, F(-4.371139000186241e-8), fnma(j, F(1.5707963705062866), x));
    float z = r * r;
    float s = fma_(z * r, horner(z, S, 3), r);
    float c = fma_(z * z, horner(z, C, 3), fma_(z, -0.5f, 1.0f));
    float quadrant = fma_(floorf(j * 0.25f), -4.0f, j);
    int is_1 = quadrant >= 0.5f && quadrant < 1.5f;
    int upper = quadrant >= 1.5f;
    int is_3 = quadrant >= 2.5f;
    float sine = is_1 || is_3 ? c : s;
    float cosine = is_1 || is_3 ? s : c;
    *sin_x = upper ? -sine : sine;
    *cos_x = is_1 || (upper && !is_3) ? -cosine : cosine;
}
#endif

#if OCTOPUS_NEEDS_EULER
static float with_sign(float magnitude, float sign)
{
    return from_bits((to_bits(magnitude) & 0x7fffffffu) | (to_bits(sign) & 0x80000000u));
}

static float atan_2(float y, float x)
{
    static const float P[] = {F(8.05374449538e-2), F(-1.38776856032e-1), F(1.99777106478e-1), F(-3.33329491139e-1)};
    float ax = absolute(x), ay = absolute(y);
    int steep = ay > ax;
    float hi = steep ? ay : ax;
    float lo = steep ? ax : ay;
    int big = lo > hi * F(0.41421356237309505);
    float numerator = big ? lo - hi : lo;
    float denominator = big ? lo + hi : hi;
    float t = numerator / (denominator > 0.0f ? denominator : 1.0f);
    float z = t * t;
    float a = fma_(horner(z, P, 4) * z, t, t);
    a = big ? a + F(0.78539816339744830962) : a;
    a = steep ? F(1.57079632679489661923) - a : a;
    a = x < 0.0f ? F(3.14159265358979323846) - a : a;
    return with_sign(a, y);
}
#endif

#if OCTOPUS_NEEDS_EXP || OCTOPUS_NEEDS_TANH
static float power_of_2(float k) { return from_bits((uint32_t)((int32_t)k + 127) << 23); }

static float exponential(float x)
{
    static const float P[] = {F(1.98756915e-4), F(1.39819995e-3), F(8.3334519e-3),
                              F(4.1665796e-2),  F(1.66666655e-1), F(5.0000001e-1)};
    float c = clamp(x, -104.0f, 89.0f);
    float n = rintf(c * F(1.44269504088896340736));
    float r = fnma(n, F(-2.1219444e-4), fnma(n, F(0.693359375), c));
    float y = fma_(horner(r, P, 6), r * r, r + 1.0f);
    float n1 = floorf(n * 0.5f);
    y = (y * power_of_2(n1)) * power_of_2(n - n1);
    y = x > F(88.73) ? from_bits(0x7f800000u) : y;
    return x <= from_bits(0x7f800000u) ? y : x;
}
#endif

#if OCTOPUS_NEEDS_TANH
static float hyperbolic_tangent(float x)
{
    static const float P[] = {F(-5.70498873e-3), F(2.06390888e-2), F(-5.37397153e-2), F(1.33314421e-1), F(-3.33332819e-1)};
    float a = absolute(x);
    float z = x * x;
    float small = fma_(horner(z, P, 5) * z, x, x);
    float e = exponential(a + a);
    float large = 1.0f - 2.0f / (e + 1.0f);
    return a < 0.625f ? small : from_bits((to_bits(large) & 0x7fffffffu) | (to_bits(x) & 0x80000000u));
}
#endif

/* ---- vectors and rotations; matrices are rows ---- */

#if OCTOPUS_NEEDS_ALGEBRA
static float dot(const float a[3], const float b[3]) { return fma_(a[2], b[2], fma_(a[1], b[1], a[0] * b[0])); }


static void mat_t_vec(const matrix *m, const float v[3], float out[3])
{
    int i;
    for (i = 0; i < 3; i++) out[i] = fma_(v[2], m->row[2][i], fma_(v[1], m->row[1][i], v[0] * m->row[0][i]));
}
#endif

#if OCTOPUS_NEEDS_HANDS
static void mat_vec(const matrix *m, const float v[3], float out[3])
{
    int i;
    for (i = 0; i < 3; i++) out[i] = dot(m->row[i], v);
}

static void mat_mat(const matrix *a, const matrix *b, matrix *out)
{
    int i;
    for (i = 0; i < 3; i++) mat_t_vec(b, a->row[i], out->row[i]);
}
#endif

#if OCTOPUS_NEEDS_HAND_VELOCITIES || OCTOPUS_POSTURES
static void cross_add(const float a[3], const float b[3], const float c[3], float out[3])
{
    out[0] = fnma(a[2], b[1], fma_(a[1], b[2], c[0]));
    out[1] = fnma(a[0], b[2], fma_(a[2], b[0], c[1]));
    out[2] = fnma(a[1], b[0], fma_(a[0], b[1], c[2]));
}

static void cross(const float a[3], const float b[3], float out[3])
{
    out[0] = fnma(a[2], b[1], a[1] * b[2]);
    out[1] = fnma(a[0], b[2], a[2] * b[0]);
    out[2] = fnma(a[1], b[0], a[0] * b[1]);
}
#endif

static void quaternion_to_rotation(const float q[4], matrix *rotation)
{
    float (*r)[3] = rotation->row;
    float w = q[0], x = q[1], y = q[2], z = q[3];
    float x2 = 2.0f * x, y2 = 2.0f * y, z2 = 2.0f * z;
    float wx = w * x2, wy = w * y2, wz = w * z2;
    float xy = x * y2, xz = x * z2, yz = y * z2;
    r[0][0] = fnma(z2, z, fnma(y2, y, 1.0f));
    r[0][1] = xy - wz;
    r[0][2] = xz + wy;
    r[1][0] = xy + wz;
    r[1][1] = fnma(z2, z, fnma(x2, x, 1.0f));
    r[1][2] = yz - wx;
    r[2][0] = xz - wy;
    r[2][1] = yz + wx;
    r[2][2] = fnma(y2, y, fnma(x2, x, 1.0f));
}

#if OCTOPUS_LAYOUT == OCTOPUS_LAYOUT_ARM
static void euler_to_rotation(const float angles[3], matrix *rotation)
{
    float (*r)[3] = rotation->row;
    float sa, ca, sb, cb, sc, cc, sa_sb, ca_sb;
    sin_cos(angles[0], &sa, &ca);
    sin_cos(angles[1], &sb, &cb);
    sin_cos(angles[2], &sc, &cc);
    sa_sb = sa * sb;
    ca_sb = ca * sb;
    r[0][0] = cb * cc;
    r[0][1] = -(cb * sc);
    r[0][2] = sb;
    r[1][0] = fma_(sa_sb, cc, ca * sc);
    r[1][1] = fnma(sa_sb, sc, ca * cc);
    r[1][2] = -(sa * cb);
    r[2][0] = fnma(ca_sb, cc, sa * sc);
    r[2][1] = fma_(ca_sb, sc, sa * cc);
    r[2][2] = ca * cb;
}

/* Axis of the rotation from `from` to `to`, times twice the sine of half its angle. */
static void rotation_difference(const matrix *to, const matrix *from, float out[3])
{
    float trace = dot(to->row[0], from->row[0]) + dot(to->row[1], from->row[1]) + dot(to->row[2], from->row[2]);
    float k = 0.5f / sqrtf(maximum(fma_(trace, 0.25f, 0.25f), F(0.01)));
    out[0] = k * (dot(to->row[2], from->row[1]) - dot(to->row[1], from->row[2]));
    out[1] = k * (dot(to->row[0], from->row[2]) - dot(to->row[2], from->row[0]));
    out[2] = k * (dot(to->row[1], from->row[0]) - dot(to->row[0], from->row[1]));
}
#endif

#if OCTOPUS_NEEDS_EULER
static void rotation_to_euler(const matrix *r, float angles[3])
{
    float cos_b = sqrtf(fma_(r->row[2][2], r->row[2][2], r->row[1][2] * r->row[1][2]));
    angles[0] = -atan_2(r->row[1][2], r->row[2][2]);
    angles[1] = -atan_2(-r->row[0][2], cos_b);
    angles[2] = -atan_2(r->row[0][1], r->row[0][0]);
}
#endif

/* ---- where the hands are ---- */

#if OCTOPUS_NEEDS_HANDS
/* A vector behind a link's twist about x, from before it. */
static void untwist(const link_type *link, const float v[3], float out[3])
{
    float x = v[0], y = v[1], z = v[2];
    out[0] = x;
    if (link->twist == 0) { out[1] = y; out[2] = z; }
    else if (link->twist == 1) { out[1] = z; out[2] = -y; }
    else if (link->twist == -1) { out[1] = -z; out[2] = y; }
    else {
        out[1] = fma_(link->cosine, y, link->sine * z);
        out[2] = fnma(link->sine, y, link->cosine * z);
    }
}

/* A vector behind a turn about z, from before it. */
static void unturn(float sine, float cosine, float v[3])
{
    float x = v[0], y = v[1];
    v[0] = fma_(cosine, x, sine * y);
    v[1] = fnma(sine, x, cosine * y);
}

typedef struct {
    float position[3];
    matrix rotation;
    float linear[3];
    float angular[3];
} hand_type;

static void find_hand(const reading_type *reading, int arm, hand_type *hand)
{
    const kind_type *kind = &KINDS[ARMS[arm].kind];
    const link_type *links = &LINKS[kind->first_link];
    const int first = ARM_JOINTS[arm].first;
    matrix r, to_world;
    float o[3], v[3], turned[3];
    int i, j;
#if OCTOPUS_NEEDS_HAND_VELOCITIES
    float angular[3], linear[3];
    mat_t_vec(&reading->base_rotation, reading->base_velocity, v);
    cross_add(reading->base_angular_velocity, ARMS[arm].position, v, linear);
    mat_t_vec(&ARMS[arm].rotation, linear, v);
    memcpy(linear, v, sizeof linear);
    mat_t_vec(&ARMS[arm].rotation, reading->base_angular_velocity, angular);
#endif
    r = ARMS[arm].rotation;
    memcpy(o, ARMS[arm].position, sizeof o);
    for (j = 0; j < ARM_JOINTS[arm].n; j++) {
        float sine, cosine;
        if (j > 0) {
            const link_type *before = &links[j - 1];
#if OCTOPUS_NEEDS_HAND_VELOCITIES
            memcpy(v, linear, sizeof v);
            if (before->has_a) {
                v[1] = fma_(angular[2], before->a, v[1]);
                v[2] = fnma(angular[1], before->a, v[2]);
            }
            if (before->has_d) {
                v[0] = fma_(angular[1], before->d, v[0]);
                v[1] = fnma(angular[0], before->d, v[1]);
            }
            untwist(before, v, linear);
            untwist(before, angular, turned);
            memcpy(angular, turned, sizeof angular);
#endif
            for (i = 0; i < 3; i++) {
                if (before->has_a) o[i] = fma_(before->a, r.row[i][0], o[i]);
                if (before->has_d) o[i] = fma_(before->d, r.row[i][2], o[i]);
                untwist(before, r.row[i], turned);
                memcpy(r.row[i], turned, sizeof turned);
            }
        }
        sin_cos(reading->joint_angles[first + j], &sine, &cosine);
        for (i = 0; i < 3; i++) unturn(sine, cosine, r.row[i]);
#if OCTOPUS_NEEDS_HAND_VELOCITIES
        unturn(sine, cosine, angular);
        unturn(sine, cosine, linear);
        angular[2] += reading->joint_rates[first + j];
#endif
    }
    mat_mat(&reading->base_rotation, &r, &to_world);
    mat_vec(&r, kind->tool_position, v);
    for (i = 0; i < 3; i++) v[i] = o[i] + v[i];
    mat_vec(&reading->base_rotation, v, turned);
    for (i = 0; i < 3; i++) hand->position[i] = reading->base_position[i] + turned[i];
    mat_mat(&to_world, &kind->tool_rotation, &hand->rotation);
#if OCTOPUS_NEEDS_HAND_VELOCITIES
    cross(angular, kind->tool_position, v);
    for (i = 0; i < 3; i++) v[i] = linear[i] + v[i];
    mat_vec(&to_world, v, hand->linear);
    mat_vec(&to_world, angular, hand->angular);
#endif
}
#endif

@POSTURES@
/* ---- what agents see ---- */

#if OCTOPUS_LAYOUT == OCTOPUS_LAYOUT_OTHER
static float *put(float *out, const float *values, size_t n)
{
    memcpy(out, values, n * sizeof *values);
    return out + n;
}
#endif

/* What belongs to the joints of an arm or of an agent, and zeros up to the room of the longest one. */
static float *put_of_joints(float *out, const float *values, int n, int room)
{
    int i;
    for (i = 0; i < room; i++) out[i] = i < n ? values[i] : 0.0f;
    return out + room;
}

#if OCTOPUS_LAYOUT == OCTOPUS_LAYOUT_ARM
/* A vector in axes of the base, as an arm sees it. */
static float *put_seen(float *out, int arm, const float v[3])
{
    int i;
    for (i = 0; i < 3; i++) {
        const float *axis = ARMS[arm].axes[i];
        out[i] = fma_(axis[0], v[0], fma_(axis[1], v[1], axis[2] * v[2]));
    }
    return out + 3;
}

static float *put_squashed(float *out, int arm, const float v[3], float inverse_width)
{
    float squashed[3];
    int i;
    for (i = 0; i < 3; i++) squashed[i] = hyperbolic_tangent(v[i] * inverse_width);
    return put_seen(out, arm, squashed);
}

#if OCTOPUS_TASK & OCTOPUS_TRAJECTORY
/* Numbers of a hand's errors, and of how its goal moves. */
#if OCTOPUS_TASK & OCTOPUS_MOVING
#define HAND_NUMBERS 24
#else
#define HAND_NUMBERS 18
#endif

static float *put_hand(float *out, int arm, const reading_type *reading)
{
    hand_type hand;
    matrix target, actual;
    float error[3], euler[3], turned[3], v[3], rotation[3];
    int i;
    if (!ARMS[arm].reaches) {
        for (i = 0; i < HAND_NUMBERS; i++) out[i] = 0.0f;
        return out + HAND_NUMBERS;
    }
    find_hand(reading, arm, &hand);
    for (i = 0; i < 3; i++) error[i] = reading->hand_goals[arm][i] - hand.position[i];
    mat_t_vec(&reading->base_rotation, error, v);
    euler_to_rotation(&reading->hand_goals[arm][3], &target);
    rotation_to_euler(&hand.rotation, euler);
    euler_to_rotation(euler, &actual);
    rotation_difference(&target, &actual, turned);
    mat_t_vec(&reading->base_rotation, turned, rotation);
    out = put_seen(out, arm, v);
    out = put_seen(out, arm, rotation);
    out = put_squashed(out, arm, v, F(1.0 / 0.05));
    out = put_squashed(out, arm, v, F(1.0 / 0.015));
    out = put_squashed(out, arm, rotation, F(1.0 / 0.08));
    out = put_squashed(out, arm, rotation, F(1.0 / 0.025));
#if OCTOPUS_TASK & OCTOPUS_MOVING
    for (i = 0; i < 6; i += 3) {
        mat_t_vec(&reading->base_rotation, &reading->hand_goal_velocities[arm][i], v);
        out = put_seen(out, arm, v);
    }
#endif
    return out;
}
#endif

static void see(const reading_type *reading, const octopus_memory *memory, float *out)
{
    int arm, j;
    for (arm = 0; arm < OCTOPUS_ARMS; arm++) {
        float *at = out + 2 * arm * OCTOPUS_OBSERVATION;
        const int first = ARM_JOINTS[arm].first, n = ARM_JOINTS[arm].n;
        float v[3], angles[OCTOPUS_ARM_JOINTS];
#if OCTOPUS_SIN_COS
        float cosines[OCTOPUS_ARM_JOINTS];
#endif
        mat_t_vec(&reading->base_rotation, reading->base_velocity, v);
        at = put_seen(at, arm, v);
        at = put_seen(at, arm, reading->base_angular_velocity);
        for (j = 0; j < n; j++) {
            angles[j] = reading->joint_angles[first + j] - ARMS[arm].home[j];
#if OCTOPUS_SIN_COS
            sin_cos(angles[j], &angles[j], &cosines[j]);
#endif
        }
        at = put_of_joints(at, angles, n, OCTOPUS_ARM_JOINTS);
#if OCTOPUS_SIN_COS
        at = put_of_joints(at, cosines, n, OCTOPUS_ARM_JOINTS);
#endif
        at = put_of_joints(at, &reading->joint_rates[first], n, OCTOPUS_ARM_JOINTS);
#if OCTOPUS_TASK & OCTOPUS_TRAJECTORY
        at = put_hand(at, arm, reading);
#endif
#if OCTOPUS_POSTURES
        at = put_posture(at, &memory->postures[arm]);
#endif
#if OCTOPUS_TASK & OCTOPUS_REORIENTATION
        {
            matrix target;
            float turned[3];
            euler_to_rotation(reading->base_goal, &target);
            rotation_difference(&target, &reading->base_rotation, turned);
            mat_t_vec(&reading->base_rotation, turned, v);
            at = put_seen(at, arm, v);
            at = put_squashed(at, arm, v, F(1.0 / 0.08));
            at = put_squashed(at, arm, v, F(1.0 / 0.025));
        }
#endif
        put_of_joints(at, &memory->action[first], n, OCTOPUS_ARM_JOINTS);
        /* The wrist sees what the shoulder sees. */
        at = out + 2 * arm * OCTOPUS_OBSERVATION;
        memcpy(at + OCTOPUS_OBSERVATION, at, OCTOPUS_OBSERVATION * sizeof *at);
    }
}
#else
static void see(const reading_type *reading, const octopus_memory *memory, float *out)
{
    /* Hands or the base: with these layouts no task has goals for both. */
    int agent;
#if OCTOPUS_TASK & OCTOPUS_TRAJECTORY
    hand_type hand;
#endif
    float euler[3];
    (void)memory;
#if OCTOPUS_TASK & OCTOPUS_REORIENTATION
    rotation_to_euler(&reading->base_rotation, euler);
#endif
    for (agent = 0; agent < OCTOPUS_AGENTS; agent++) {
        const int first = AGENT_JOINTS[agent].first, n = AGENT_JOINTS[agent].n;
        out = put(out, reading->base_position, 3);
        out = put(out, reading->base_attitude, 4);
        out = put_of_joints(out, &reading->joint_angles[first], n, OCTOPUS_AGENT_ACTIONS);
        out = put(out, reading->base_velocity, 3);
        out = put(out, reading->base_angular_velocity, 3);
        out = put_of_joints(out, &reading->joint_rates[first], n, OCTOPUS_AGENT_ACTIONS);
#if OCTOPUS_TASK & OCTOPUS_TRAJECTORY
        if (agent % 2 == 0) find_hand(reading, agent / 2, &hand);
        rotation_to_euler(&hand.rotation, euler);
        out = put(out, agent % 2 == 0 ? hand.position : euler, 3);
#if OCTOPUS_NEEDS_HAND_VELOCITIES
        {
            int i;
            for (i = 0; i < 3; i++) *out++ = (agent % 2 == 0 ? hand.linear : hand.angular)[i] * F(0.02);
        }
#endif
        out = put(out, reading->hand_goals[agent / 2], 6);
#else
        out = put(out, euler, 3);
        out = put(out, reading->base_goal, 3);
#endif
    }
}
#endif

/* ---- the networks ---- */

#if OCTOPUS_NEEDS_LAYER_NORM
static void layer_norm(float *x, size_t n, const float *gain, const float *shift)
{
    float scale = F(1.0 / (double)n);
    float sums[4] = {0.0f, 0.0f, 0.0f, 0.0f};
    float mean, inverse;
    size_t i;
    for (i = 0; i < n; i++) sums[i % 4] += x[i];
    mean = ((sums[0] + sums[1]) + (sums[2] + sums[3])) * scale;
    sums[0] = sums[1] = sums[2] = sums[3] = 0.0f;
    for (i = 0; i < n; i++) {
        float d = x[i] - mean;
        sums[i % 4] = fma_(d, d, sums[i % 4]);
    }
    inverse = 1.0f / sqrtf(((sums[0] + sums[1]) + (sums[2] + sums[3])) * scale + F(1e-5));
    for (i = 0; i < n; i++) x[i] = fma_(x[i] - mean, gain[i] * inverse, shift[i]);
}
#endif

#if OCTOPUS_NEEDS_BF16
/* The nearest bfloat16, ties to even; zero where x is below 2 to the power of -50. */
static float rounded(float x)
{
    uint32_t bits = to_bits(x);
    if (absolute(x) < F(1.0 / 1125899906842624.0)) return 0.0f;
    return from_bits((bits + 0x7fffu + (bits >> 16 & 1u)) & 0xffff0000u);
}

static float widened(uint16_t upper) { return from_bits((uint32_t)upper << 16); }
#endif

static void hidden_layer(const layer_type *layer, int actor, float *x, float *out)
{
    const size_t inputs = layer->inputs, outputs = layer->outputs;
    size_t i, o;
    memcpy(out, layer->bias + (size_t)layer->bias_row[actor] * outputs, outputs * sizeof *out);
#if OCTOPUS_NEEDS_BF16
    if (layer->half_weight) {
        const uint16_t *w = layer->half_weight + (size_t)layer->weight_row[actor] * (inputs + inputs % 2) * outputs;
        for (i = 0; i < inputs; i++) x[i] = rounded(x[i]);
        if (inputs % 2) x[inputs] = 0.0f;
        /* Products of two bfloat16 are exact in single precision, so a sum of them is that of a fused
         * multiply-add; the second of each pair is added first. */
        for (i = 0; i < inputs; i += 2, w += 2 * outputs) {
            const float first = x[i], second = x[i + 1];
            for (o = 0; o < outputs; o++) {
                out[o] = first * widened(w[o]) + (second * widened(w[outputs + o]) + out[o]);
            }
        }
        return;
    }
#endif
    {
        const float *w = layer->weight + (size_t)layer->weight_row[actor] * inputs * outputs;
        for (i = 0; i < inputs; i++, w += outputs) {
            const float input = x[i];
            for (o = 0; o < outputs; o++) out[o] = fma_(w[o], input, out[o]);
        }
    }
}

static void activate(float *x, size_t n)
{
    size_t i;
    for (i = 0; i < n; i++) {
#if OCTOPUS_ACTIVATION == OCTOPUS_RELU
        x[i] = maximum(x[i], 0.0f);
#elif OCTOPUS_ACTIVATION == OCTOPUS_ELU
        x[i] = x[i] > 0.0f ? x[i] : exponential(minimum(x[i], 0.0f)) - 1.0f;
#else
        x[i] = hyperbolic_tangent(x[i]);
#endif
    }
}

/* What an actor says to what it sees. */
static void think(int actor, const float *seen, float *mean)
{
    /* One more for the second of a pair. */
    float ping[OCTOPUS_WIDEST + 1], pong[OCTOPUS_WIDEST + 1];
    float *x = ping, *next = pong, *swap;
    size_t i;
    int layer;
    memcpy(x, seen, OCTOPUS_ACTOR_INPUT * sizeof *x);
#if OCTOPUS_INPUT_NORM == OCTOPUS_RUNNING
    for (i = 0; i < OCTOPUS_ACTOR_INPUT; i++) {
        const float shift = input_mean[input_mean_row[actor] * OCTOPUS_ACTOR_INPUT + i];
        const float scale = input_inverse_std[input_inverse_std_row[actor] * OCTOPUS_ACTOR_INPUT + i];
        x[i] = clamp((x[i] - shift) * scale, -OCTOPUS_INPUT_CLIP, OCTOPUS_INPUT_CLIP);
    }
#elif OCTOPUS_INPUT_NORM == OCTOPUS_LAYER_NORM
    layer_norm(x, OCTOPUS_ACTOR_INPUT, &input_gain[input_gain_row[actor] * OCTOPUS_ACTOR_INPUT],
               &input_bias[input_bias_row[actor] * OCTOPUS_ACTOR_INPUT]);
#endif
    for (layer = 0; layer < OCTOPUS_LAYERS; layer++) {
        hidden_layer(&LAYERS[layer], actor, x, next);
        if (layer + 1 < OCTOPUS_LAYERS) {
            activate(next, LAYERS[layer].outputs);
#if OCTOPUS_HIDDEN_LAYER_NORM
            layer_norm(next, LAYERS[layer].outputs, LAYERS[layer].gain + LAYERS[layer].gain_row[actor] * LAYERS[layer].outputs,
                       LAYERS[layer].shift + LAYERS[layer].shift_row[actor] * LAYERS[layer].outputs);
#endif
        }
        swap = x;
        x = next;
        next = swap;
    }
    for (i = 0; i < OCTOPUS_ACTOR_OUTPUT; i++) {
#if OCTOPUS_SQUASH
        mean[i] = hyperbolic_tangent(x[i]) * OCTOPUS_ACTION_LIMIT;
#else
        mean[i] = x[i];
#endif
    }
}

/* ---- what others call ---- */

/* Also false for what is not a number. */
static int within(const double *values, size_t n, double most)
{
    size_t i;
    for (i = 0; i < n; i++) {
        if (!(values[i] >= -most && values[i] <= most)) return 0;
    }
    return 1;
}

static void single(const double *from, float *to, size_t n)
{
    size_t i;
    for (i = 0; i < n; i++) to[i] = (float)from[i];
}

static octopus_status read_all(const octopus_state *state, const octopus_goals *goals, reading_type *reading)
{
    double square = 0.0;
    int i;
    if (!within(state->base_position, 3, 1e6) || !within(state->base_attitude, 4, 1e6)
        || !within(state->base_velocity, 3, 1e6) || !within(state->base_angular_velocity, 3, 1e6)
        || !within(state->joint_angles, OCTOPUS_JOINTS, 1e6) || !within(state->joint_rates, OCTOPUS_JOINTS, 1e6)) {
        return OCTOPUS_STATE_NOT_FINITE;
    }
    for (i = 0; i < 4; i++) square += state->base_attitude[i] * state->base_attitude[i];
    if (square < 0.999 || square > 1.001) return OCTOPUS_ATTITUDE_NOT_UNIT;
    if (!within(state->joint_angles, OCTOPUS_JOINTS, 1e3)) return OCTOPUS_ANGLE_TOO_LARGE;
    single(state->base_position, reading->base_position, 3);
    single(state->base_attitude, reading->base_attitude, 4);
    single(state->base_velocity, reading->base_velocity, 3);
    single(state->base_angular_velocity, reading->base_angular_velocity, 3);
    single(state->joint_angles, reading->joint_angles, OCTOPUS_JOINTS);
    single(state->joint_rates, reading->joint_rates, OCTOPUS_JOINTS);
    quaternion_to_rotation(reading->base_attitude, &reading->base_rotation);
#if OCTOPUS_TASK & OCTOPUS_TRAJECTORY
    for (i = 0; i < OCTOPUS_ARMS; i++) {
        float mount[3], away[3];
        int j;
        if (!ARMS[i].reaches) continue;
        if (!within(goals->hands[i], 3, 1e6) || !within(goals->hands[i] + 3, 3, 1e3)) return OCTOPUS_GOAL_NOT_FINITE;
        single(goals->hands[i], reading->hand_goals[i], 6);
        mat_vec(&reading->base_rotation, ARMS[i].position, mount);
        for (j = 0; j < 3; j++) away[j] = reading->hand_goals[i][j] - (reading->base_position[j] + mount[j]);
        if (dot(away, away) > ARMS[i].reach * ARMS[i].reach) return OCTOPUS_GOAL_OUT_OF_REACH;
#if OCTOPUS_TASK & OCTOPUS_MOVING
        if (!within(goals->hand_velocities[i], 6, 1e6)) return OCTOPUS_GOAL_NOT_FINITE;
        single(goals->hand_velocities[i], reading->hand_goal_velocities[i], 6);
#endif
    }
#endif
#if OCTOPUS_TASK & OCTOPUS_REORIENTATION
    if (!within(goals->base, 3, 1e3)) return OCTOPUS_GOAL_NOT_FINITE;
    single(goals->base, reading->base_goal, 3);
#endif
    return OCTOPUS_OK;
}

void octopus_controller_reset(octopus_memory *memory)
{
    int i;
    for (i = 0; i < OCTOPUS_JOINTS; i++) memory->action[i] = 0.0f;
#if OCTOPUS_POSTURES
    memset(memory->postures, 0, sizeof memory->postures);
    /* Nothing is the same as what is not a number. */
    for (i = 0; i < OCTOPUS_ARMS; i++) memory->postures[i].goal[0] = from_bits(0x7fc00000u);
    for (i = 0; i < 7; i++) memory->base[i] = memory->believed[i] = from_bits(0x7fc00000u);
    memory->age = 0.0f;
#endif
}

static octopus_status observe(const octopus_state *state, const octopus_goals *goals, octopus_memory *memory,
                              float observations[OCTOPUS_AGENTS * OCTOPUS_OBSERVATION])
{
    reading_type reading;
    octopus_status status;
    if (!state || !goals || !memory || !observations) return OCTOPUS_NULL;
    status = read_all(state, goals, &reading);
    if (status != OCTOPUS_OK) return status;
#if OCTOPUS_POSTURES
    look(&reading, memory);
#endif
    see(&reading, memory, observations);
    return OCTOPUS_OK;
}

octopus_status octopus_observe(const octopus_state *state, const octopus_goals *goals,
                               const octopus_memory *memory,
                               float observations[OCTOPUS_AGENTS * OCTOPUS_OBSERVATION])
{
    octopus_memory looked;
    if (!memory) return OCTOPUS_NULL;
    looked = *memory;
    return observe(state, goals, &looked, observations);
}

#if OCTOPUS_POSTURES
octopus_status octopus_postures(const octopus_state *state, const octopus_goals *goals,
                                octopus_memory *memory, float postures[OCTOPUS_ARMS][OCTOPUS_POSTURE_NUMBERS])
{
    reading_type reading;
    octopus_status status = state && goals && memory && postures ? read_all(state, goals, &reading) : OCTOPUS_NULL;
    int arm;
    if (status == OCTOPUS_OK) look(&reading, memory);
    else if (memory) octopus_controller_reset(memory);
    if (postures && !memory) memset(postures, 0, OCTOPUS_ARMS * sizeof postures[0]);
    for (arm = 0; memory && postures && arm < OCTOPUS_ARMS; arm++) {
        postures[arm][0] = memory->postures[arm].good;
        postures[arm][1] = memory->postures[arm].free;
        memcpy(&postures[arm][2], memory->postures[arm].left, sizeof memory->postures[arm].left);
    }
    return status;
}
#endif

static octopus_status act(const octopus_state *state, const octopus_goals *goals, octopus_memory *memory)
{
    float observations[OCTOPUS_AGENTS * OCTOPUS_OBSERVATION];
    /* An agent has as many actions as any other; those beyond its joints move nothing. */
    float means[OCTOPUS_AGENTS * OCTOPUS_AGENT_ACTIONS], actions[OCTOPUS_JOINTS];
#if OCTOPUS_POSTURES
    float guidance[OCTOPUS_JOINTS], of_agents;
    int arm;
#endif
    octopus_status status = observe(state, goals, memory, observations);
    int actor, agent, joint;
    if (status != OCTOPUS_OK) return status;
    for (actor = 0; actor < OCTOPUS_ACTORS; actor++) {
        think(actor, observations + actor * OCTOPUS_ACTOR_INPUT, means + actor * OCTOPUS_ACTOR_OUTPUT);
    }
    for (agent = 0; agent < OCTOPUS_AGENTS; agent++) {
        const joints_type *joints = &AGENT_JOINTS[agent];
        memcpy(&actions[joints->first], &means[agent * OCTOPUS_AGENT_ACTIONS], (size_t)joints->n * sizeof *means);
    }
#if OCTOPUS_POSTURES
    for (arm = 0; arm < OCTOPUS_ARMS; arm++) {
        joint = ARM_JOINTS[arm].first;
        rates(arm, &memory->postures[arm], OCTOPUS_GUIDANCE, &ACTION_LIMITS[joint], &guidance[joint]);
        of_agents = share(arm, &memory->postures[arm]);
        for (; joint < ARM_JOINTS[arm].first + ARM_JOINTS[arm].n; joint++) {
            actions[joint] = fma_(of_agents, actions[joint], guidance[joint]);
        }
    }
#endif
    for (joint = 0; joint < OCTOPUS_JOINTS; joint++) {
        if (!(absolute(actions[joint]) <= FLT_MAX)) return OCTOPUS_NO_NUMBER;
        actions[joint] = clamp(actions[joint], -ACTION_LIMITS[joint], ACTION_LIMITS[joint]);
    }
    memcpy(memory->action, actions, sizeof actions);
    return OCTOPUS_OK;
}

octopus_status octopus_controller_step(const octopus_state *state, const octopus_goals *goals,
                                       octopus_memory *memory, double command[OCTOPUS_JOINTS])
{
    octopus_status status = command ? act(state, goals, memory) : OCTOPUS_NULL;
    int joint;
    if (status != OCTOPUS_OK && memory) octopus_controller_reset(memory);
    for (joint = 0; command && joint < OCTOPUS_JOINTS; joint++) {
        command[joint] = status == OCTOPUS_OK ? (double)(memory->action[joint] * OCTOPUS_ACTION_SCALE) : 0.0;
    }
    return status;
}

octopus_state octopus_home(void) { return HOME; }

octopus_goals octopus_home_goals(void) { return HOME_GOALS; }

const char *octopus_status_text(octopus_status status)
{
    switch (status) {
    case OCTOPUS_OK: return "ok";
    case OCTOPUS_NULL: return "a pointer is null";
    case OCTOPUS_STATE_NOT_FINITE: return "a number of the state is not finite, or beyond a million";
    case OCTOPUS_ATTITUDE_NOT_UNIT: return "the quaternion of the base's attitude is not of length one";
    case OCTOPUS_ANGLE_TOO_LARGE: return "a joint angle is beyond 1,000 rad";
    case OCTOPUS_GOAL_NOT_FINITE: return "a number of the goals is not finite, or an angle beyond 1,000 rad";
    case OCTOPUS_GOAL_OUT_OF_REACH: return "a hand's goal is farther from its arm's mount than the arm is long";
    case OCTOPUS_NO_NUMBER: return "the networks gave no number";
    }
    return "no status of this controller";
}

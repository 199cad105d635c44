/* ---- goal postures: one way of each arm to its goal, chosen for all arms together, then followed ---- */

/* Moment and force, or angular and linear velocity. */
typedef struct {
    float angular[3], linear[3];
} vector_6;

/* A rigid body: its mass, that times its centre, its inertia about the origin (xx, yy, zz, xy, xz, yz). */
typedef struct {
    float mass, moment[3], inertia[6];
} body_type;

/* Inertia of several: moment = a w + b v, force = b' w + c v, where a and c are symmetric. */
typedef struct {
    float a[6], b[3][3], c[6];
} inertia_type;

typedef struct {
    float position[3];
    matrix rotation;
} frame_type;

/* From a joint to the next. */
typedef struct {
    float shift[3];
    matrix twist;
} step_type;

/* An interval of a joint in which it is stopped. */
typedef struct {
    int is;
    float centre, half;
} stop_type;

/* A rotation by right angles: which coordinate comes where, and its sign. */
typedef struct {
    int is, place[3];
    float sign[3];
} permutation_type;

/* An interval of a joint in which two bodies touch; another joint may narrow it. */
typedef struct {
    int joint, narrowing_joint;
    float centre, half, narrowing;
} angle_contact_type;

/* Of a table. */
typedef struct {
    int first, end;
} range_type;

/* All points within `radius` of the segment from a to b; or of a solid cylinder with centre a and axis b. */
typedef struct {
    int is_cylinder;
    float a[3], b[3], radius, cylinder_radius, cylinder_half;
} shape_type;

typedef struct {
    float from[3], to[3], radius;
} capsule_type;

typedef struct {
    float centre[3];
    matrix rotation;
    float half[3];
} box_type;

/* A body: its shapes, and a capsule around them; or a box. */
typedef struct {
    int first, n, is_box;
    capsule_type bound;
    box_type box;
} solid_type;

/* Two bodies that may touch. The first is the link behind a joint of the robot, the other one likewise or fixed to the
 * base. `reach` is as far as the balls around both; `simple` if both are one capsule. */
typedef struct {
    int a, b, is_link, simple;
    float reach;
} pair_type;

@POSTURE_TABLES@

/* Where the robot is. */
typedef struct {
    float position[3], attitude[4], angles[OCTOPUS_JOINTS];
    matrix rotation;
} place_type;

#define PI 3.14159265358979323846
#define PERIOD F(OCTOPUS_CONTROL_PERIOD)

static void plus(const float a[3], const float b[3], float out[3])
{
    int i;
    for (i = 0; i < 3; i++) out[i] = a[i] + b[i];
}

static void minus(const float a[3], const float b[3], float out[3])
{
    int i;
    for (i = 0; i < 3; i++) out[i] = a[i] - b[i];
}

static void times(float s, const float a[3], float out[3])
{
    int i;
    for (i = 0; i < 3; i++) out[i] = s * a[i];
}

/* s a + b */
static void times_plus(float s, const float a[3], const float b[3], float out[3])
{
    int i;
    for (i = 0; i < 3; i++) out[i] = fma_(s, a[i], b[i]);
}

static float length(const float a[3]) { return sqrtf(dot(a, a)); }

static float distance(const float a[3], const float b[3])
{
    float d[3];
    minus(a, b, d);
    return length(d);
}

/* -- one arm: damped least squares towards a pose, in axes of the base -- */

/* Where the hand is and, if asked for, how its pose changes with each joint angle. */
static void reach(int arm, const float *q, frame_type *hand, float jacobian[OCTOPUS_ARM_JOINTS][6])
{
    const kind_type *kind = &KINDS[ARMS[arm].kind];
    const step_type *steps = &STEPS[kind->first_link];
    const int n = ARM_JOINTS[arm].n;
    matrix r = ARMS[arm].rotation, next;
    float o[3], v[3], axes[OCTOPUS_ARM_JOINTS][3], origins[OCTOPUS_ARM_JOINTS][3];
    int i, j;
    memcpy(o, ARMS[arm].position, sizeof o);
    for (j = 0; j < n; j++) {
        float sine, cosine;
        sin_cos(q[j], &sine, &cosine);
        for (i = 0; i < 3; i++) {
            unturn(sine, cosine, r.row[i]);
            axes[j][i] = r.row[i][2];
            origins[j][i] = o[i];
        }
        if (j < n - 1) {
            mat_vec(&r, steps[j].shift, v);
            plus(o, v, o);
            mat_mat(&r, &steps[j].twist, &next);
            r = next;
        }
    }
    mat_vec(&r, kind->tool_position, v);
    plus(o, v, hand->position);
    mat_mat(&r, &kind->tool_rotation, &hand->rotation);
    for (j = 0; jacobian && j < n; j++) {
        minus(hand->position, origins[j], v);
        cross(axes[j], v, jacobian[j]);
        memcpy(jacobian[j] + 3, axes[j], sizeof axes[j]);
    }
}

/* J' (J J' + damping)^-1 error, by L D L'. */
static void least_squares(const float jacobian[][6], int n, float damping, const float error[6], float *step)
{
    float l[6][6], d[6], y[6];
    int i, j, k;
    memcpy(y, error, sizeof y);
    for (i = 0; i < 6; i++) {
        for (j = 0; j <= i; j++) {
            float sum = i == j ? damping : 0.0f;
            for (k = 0; k < n; k++) sum = fma_(jacobian[k][i], jacobian[k][j], sum);
            for (k = 0; k < j; k++) sum = fnma(l[i][k] * d[k], l[j][k], sum);
            if (i == j) d[i] = maximum(sum, damping);
            else l[i][j] = sum / d[j];
        }
        for (k = 0; k < i; k++) y[i] = fnma(l[i][k], y[k], y[i]);
    }
    for (i = 5; i >= 0; i--) {
        y[i] = y[i] / d[i];
        for (k = i + 1; k < 6; k++) y[i] = fnma(l[k][i], y[k], y[i]);
    }
    for (j = 0; j < n; j++) {
        step[j] = 0.0f;
        for (k = 0; k < 6; k++) step[j] = fma_(jacobian[j][k], y[k], step[j]);
    }
}

/* What remains of the damping at the goal. */
#define LEAST_DAMPING F(1e-6)

/* How far the hand is from `target` at `q` (m and rad, together); and angles that bring it nearer, if asked for. */
static float approach_damped(int arm, const frame_type *target, const float *q, float *next, float damping)
{
    const int n = ARM_JOINTS[arm].n;
    frame_type hand;
    float jacobian[OCTOPUS_ARM_JOINTS][6], error[6], step[OCTOPUS_ARM_JOINTS];
    float square, longest = F(1e-9), shorten;
    int j;
    reach(arm, q, &hand, next ? jacobian : NULL);
    minus(target->position, hand.position, error);
    rotation_difference(&target->rotation, &hand.rotation, error + 3);
    square = dot(error, error) + dot(error + 3, error + 3);
    if (next) {
        least_squares((const float (*)[6])jacobian, n, fma_(square, F(1e-2), damping), error, step);
        for (j = 0; j < n; j++) longest = maximum(longest, absolute(step[j]));
        shorten = minimum(0.5f / longest, 1.0f);
        for (j = 0; j < n; j++) next[j] = fma_(shorten, step[j], q[j]);
    }
    return sqrtf(square);
}

static float approach(int arm, const frame_type *target, const float *q, float *next)
{
    return approach_damped(arm, target, q, next, LEAST_DAMPING);
}

static float nearest_turn(float angle) { return fnma(rintf(angle * F(1.0 / (2.0 * PI))), F(2.0 * PI), angle); }

/* How far a joint has to turn, whole turns aside, on a way that leads through no stop. */
static float way(int arm, int joint, float from, float to)
{
    const stop_type *stop = &STOPS[KINDS[ARMS[arm].kind].first_link + joint];
    if (!stop->is) return nearest_turn(to - from);
    return nearest_turn(to - stop->centre - F(PI)) - nearest_turn(from - stop->centre - F(PI));
}

static int is_stopped(int arm, const float *q)
{
    const stop_type *stops = &STOPS[KINDS[ARMS[arm].kind].first_link];
    int j, stopped = 0;
    for (j = 0; j < ARM_JOINTS[arm].n; j++) {
        stopped = stopped || (stops[j].is && absolute(nearest_turn(q[j] - stops[j].centre)) < stops[j].half);
    }
    return stopped;
}

/* What counts more than any way of a joint: angles at which one is stopped, and those that do not bring the hand there. */
#define STOPPED 20.0f
#define UNSOLVED 40.0f

/* What is to be said against going to `q`. */
static float cost_of(int arm, const frame_type *target, const float *stands, const float *q)
{
    float miss = approach(arm, target, q, NULL);
    float cost = UNSOLVED + miss;
    int j;
    if (miss < F(1e-3)) {
        for (cost = 0.0f, j = 0; j < ARM_JOINTS[arm].n; j++) cost = maximum(cost, absolute(way(arm, j, stands[j], q[j])));
    }
    return is_stopped(arm, q) ? cost + STOPPED : cost;
}

/* Where a search begins: a point of an additive recurrence, half turns around home. */
static void start_at(int arm, float index, float *q)
{
    /* Of arms of up to six joints, and of those of seven. */
    static const float SHARES[2][7] = {
        {F(0.8986537), F(0.8075785), F(0.7257334), F(0.6521830), F(0.5860867), F(0.5266890), 0.0f},
        {F(0.9115924), F(0.8310006), F(0.7575338), F(0.6905620), F(0.6295111), F(0.5738575), F(0.5231241)}};
    int j;
    for (j = 0; j < ARM_JOINTS[arm].n; j++) {
        float x = index * SHARES[ARM_JOINTS[arm].n > 6][j];
        q[j] = ARMS[arm].home[j] + (x - floorf(x) - 0.5f) * F(2.0 * PI);
    }
}

static void copy_angles(int arm, const float *from, float *to) { memcpy(to, from, (size_t)ARM_JOINTS[arm].n * sizeof *to); }

/* Starts of a whole search beside where the arm stands and home. */
#define STARTS 14

/* What a start leads to that is tried later. */
static void later(int arm, const frame_type *target, float index, float *q)
{
    int step;
    start_at(arm, index, q);
    for (step = 0; step < 12; step++) {
        float next[OCTOPUS_ARM_JOINTS];
        approach(arm, target, q, next);
        copy_angles(arm, next, q);
    }
}

/* The best of many starts: where none brings the hand to its goal, what comes nearest to it. */
static void search(int arm, const frame_type *target, const float *stands, float *best)
{
    float best_cost = from_bits(0x7f800000u);
    int index, step;
    copy_angles(arm, stands, best);
    for (index = 0; index < STARTS + 2; index++) {
        float q[OCTOPUS_ARM_JOINTS], next[OCTOPUS_ARM_JOINTS], cost;
        if (index == 0) copy_angles(arm, stands, q);
        else if (index == 1) copy_angles(arm, ARMS[arm].home, q);
        else start_at(arm, (float)(index - 1), q);
        for (step = 0; step < 40; step++) {
            if (approach(arm, target, q, next) < F(1e-5)) break;
            copy_angles(arm, next, q);
        }
        cost = cost_of(arm, target, stands, q);
        if (cost < best_cost) {
            best_cost = cost;
            copy_angles(arm, q, best);
        }
    }
}

static void seen_from(const place_type *place, const float goal[6], frame_type *target)
{
    matrix to_base, rotation;
    float away[3];
    int i, j;
    for (i = 0; i < 3; i++) {
        for (j = 0; j < 3; j++) to_base.row[i][j] = place->rotation.row[j][i];
    }
    euler_to_rotation(goal + 3, &rotation);
    mat_mat(&to_base, &rotation, &target->rotation);
    minus(goal, place->position, away);
    mat_vec(&to_base, away, target->position);
}

/* Where the base is averaged, goals tremble: near singular poses angles would jump with them, and a goal that seems out of reach
 * for a moment would have another way looked for. */
#define FOLLOWING_DAMPING (OCTOPUS_TRUST < 1.0f ? F(1e-2) : LEAST_DAMPING)
#define TOO_FAR (OCTOPUS_TRUST < 1.0f ? F(40.02) : UNSOLVED)

/* Whether angles of this cost do not bring the hand to its goal, but near enough. */
static int leads_near(float cost) { return cost >= UNSOLVED && cost < TOO_FAR; }

/* Has a posture follow the base, unless that `rests`; says what is left to go. */
static void follow(int arm, octopus_posture *posture, const float goal[6], const place_type *place, int rests)
{
    const float *stands = &place->angles[ARM_JOINTS[arm].first];
    float *angles = posture->angles;
    int j;
    if (!rests) {
        frame_type target;
        float before[OCTOPUS_ARM_JOINTS], next[OCTOPUS_ARM_JOINTS], cost;
        seen_from(place, goal, &target);
        copy_angles(arm, angles, before);
        approach_damped(arm, &target, angles, next, FOLLOWING_DAMPING);
        approach_damped(arm, &target, next, angles, FOLLOWING_DAMPING);
        cost = cost_of(arm, &target, stands, angles);
        if (cost >= UNSOLVED) {
            /* Angles that only come near would wander with the base. */
            float cost_before = cost_of(arm, &target, stands, before);
            if (cost_before <= cost) {
                copy_angles(arm, before, angles);
                cost = cost_before;
            }
        }
        if (cost >= STOPPED && !leads_near(cost)) {
            float other_cost;
            posture->tried = posture->tried + 1.0f;
            later(arm, &target, posture->tried, next);
            other_cost = cost_of(arm, &target, stands, next);
            if (other_cost < STOPPED) {
                copy_angles(arm, next, angles);
                cost = other_cost;
            }
        }
        posture->good = cost < STOPPED || leads_near(cost) ? 1.0f : 0.0f;
    }
    posture->free = is_stopped(arm, angles) ? 0.0f : 1.0f;
    for (j = 0; j < ARM_JOINTS[arm].n; j++) posture->left[j] = way(arm, j, stands[j], angles[j]);
}

/* `factor` times what is left to go, all joints in proportion, within `limits`; nothing where a joint would be stopped. */
static void rates(int arm, const octopus_posture *posture, float factor, const float *limits, float *out)
{
    float of_all = factor * posture->free, excess = 1.0f;
    int j;
    for (j = 0; j < ARM_JOINTS[arm].n; j++) {
        out[j] = of_all * posture->left[j];
        excess = maximum(excess, absolute(out[j]) / limits[j]);
    }
    for (j = 0; j < ARM_JOINTS[arm].n; j++) out[j] = out[j] / excess;
}

/* Share of what an agent says: less near the goal posture. */
static float share(int arm, const octopus_posture *posture)
{
    float farthest = 0.0f;
    int j;
    if (OCTOPUS_FADE == 0.0f) return 1.0f;
    for (j = 0; j < ARM_JOINTS[arm].n; j++) farthest = maximum(farthest, absolute(posture->left[j]));
    return minimum(farthest / OCTOPUS_FADE, 1.0f);
}

/* -- how the base gives way to arms that move -- */

/* A vector before a link's twist about x, from behind it. */
static void twist(const link_type *link, const float v[3], float out[3])
{
    float x = v[0], y = v[1], z = v[2];
    out[0] = x;
    if (link->twist == 0) { out[1] = y; out[2] = z; }
    else if (link->twist == 1) { out[1] = -z; out[2] = y; }
    else if (link->twist == -1) { out[1] = z; out[2] = -y; }
    else {
        out[1] = fnma(link->sine, z, link->cosine * y);
        out[2] = fma_(link->sine, y, link->cosine * z);
    }
}

/* A vector before a turn about z, from behind it. */
static void turn(float sine, float cosine, float v[3])
{
    float x = v[0], y = v[1];
    v[0] = fnma(sine, y, cosine * x);
    v[1] = fma_(sine, x, cosine * y);
}

static void sym_vec(const float m[6], const float v[3], float out[3])
{
    const float rows[3][3] = {{m[0], m[3], m[4]}, {m[3], m[1], m[5]}, {m[4], m[5], m[2]}};
    int i;
    for (i = 0; i < 3; i++) out[i] = dot(rows[i], v);
}

static void turn_sym(float s, float c, float m[6])
{
    float xx = m[0], yy = m[1], xy = m[3], xz = m[4], yz = m[5];
    float e = fma_(s, xx - yy, c * (xy + xy));
    m[0] = fnma(s, e, xx);
    m[1] = fma_(s, e, yy);
    m[3] = fma_(c, e, -xy);
    m[4] = fnma(s, yz, c * xz);
    m[5] = fma_(s, xz, c * yz);
}

static void turn_mat(float s, float c, float m[3][3])
{
    float e = fma_(s, m[0][0] - m[1][1], c * (m[0][1] + m[1][0]));
    float xy = m[0][1], yx = m[1][0], xz = m[0][2], yz = m[1][2], zx = m[2][0], zy = m[2][1];
    m[0][0] = fnma(s, e, m[0][0]);
    m[0][1] = fma_(c, e, -yx);
    m[0][2] = fnma(s, yz, c * xz);
    m[1][0] = fma_(c, e, -xy);
    m[1][1] = fma_(s, e, m[1][1]);
    m[1][2] = fma_(s, xz, c * yz);
    m[2][0] = fnma(s, zy, c * zx);
    m[2][1] = fma_(s, zx, c * zy);
}

static void twist_sym(const link_type *link, float m[6])
{
    float yy = m[1], zz = m[2], xy = m[3], xz = m[4], yz = m[5];
    if (link->twist == 1) {
        m[1] = zz; m[2] = yy; m[3] = -xz; m[4] = xy; m[5] = -yz;
    } else if (link->twist == -1) {
        m[1] = zz; m[2] = yy; m[3] = xz; m[4] = -xy; m[5] = -yz;
    } else if (link->twist != 0) {
        /* A turn about x is a turn about z of the axes (y, z, x). */
        float turned[6];
        turned[0] = yy; turned[1] = zz; turned[2] = m[0];
        turned[3] = yz; turned[4] = xy; turned[5] = xz;
        turn_sym(link->sine, link->cosine, turned);
        m[0] = turned[2]; m[1] = turned[0]; m[2] = turned[1];
        m[3] = turned[4]; m[4] = turned[5]; m[5] = turned[3];
    }
}

static void twist_mat(const link_type *link, float m[3][3])
{
    float columns[3][3], column[3];
    int i, j;
    for (j = 0; j < 3; j++) {
        for (i = 0; i < 3; i++) column[i] = m[i][j];
        twist(link, column, columns[j]);
    }
    for (i = 0; i < 3; i++) {
        for (j = 0; j < 3; j++) column[j] = columns[j][i];
        twist(link, column, m[i]);
    }
}

static void add_body(inertia_type *to, const body_type *body)
{
    const float *h = body->moment;
    int i;
    for (i = 0; i < 6; i++) to->a[i] += body->inertia[i];
    to->b[0][1] -= h[2];
    to->b[0][2] += h[1];
    to->b[1][0] += h[2];
    to->b[1][2] -= h[0];
    to->b[2][0] -= h[1];
    to->b[2][1] += h[0];
    for (i = 0; i < 3; i++) to->c[i] += body->mass;
}

/* Seen from the link before: twisted back, then about a point that is shifted. */
static void to_previous(const link_type *link, inertia_type *of)
{
    float *a = of->a, (*b)[3] = of->b, *c = of->c;
    twist_sym(link, a);
    twist_mat(link, b);
    twist_sym(link, c);
    if (link->has_a) {
        float s = link->a;
        a[1] = fnma(s, b[1][2], a[1]);
        a[2] = fma_(s, b[2][1], a[2]);
        a[5] = fnma(s, b[2][2], a[5]);
        b[1][0] = fnma(s, c[4], b[1][0]);
        b[1][1] = fnma(s, c[5], b[1][1]);
        b[1][2] = fnma(s, c[2], b[1][2]);
        b[2][0] = fma_(s, c[3], b[2][0]);
        b[2][1] = fma_(s, c[1], b[2][1]);
        b[2][2] = fma_(s, c[5], b[2][2]);
        a[1] = fnma(s, b[1][2], a[1]);
        a[2] = fma_(s, b[2][1], a[2]);
        a[3] = fnma(s, b[0][2], a[3]);
        a[4] = fma_(s, b[0][1], a[4]);
        a[5] = fma_(s, b[1][1], a[5]);
    }
    if (link->has_d) {
        float s = link->d;
        a[0] = fnma(s, b[0][1], a[0]);
        a[1] = fma_(s, b[1][0], a[1]);
        a[3] = fnma(s, b[1][1], a[3]);
        a[4] = fnma(s, b[2][1], a[4]);
        a[5] = fma_(s, b[2][0], a[5]);
        b[0][0] = fnma(s, c[3], b[0][0]);
        b[0][1] = fnma(s, c[1], b[0][1]);
        b[0][2] = fnma(s, c[5], b[0][2]);
        b[1][0] = fma_(s, c[0], b[1][0]);
        b[1][1] = fma_(s, c[3], b[1][1]);
        b[1][2] = fma_(s, c[4], b[1][2]);
        a[0] = fnma(s, b[0][1], a[0]);
        a[1] = fma_(s, b[1][0], a[1]);
        a[3] = fma_(s, b[0][0], a[3]);
    }
}

/* Rows and columns of the entries of a symmetric matrix. */
static const int ROWS[6] = {0, 1, 2, 0, 0, 1}, COLUMNS[6] = {0, 1, 2, 1, 2, 2};

/* R m R' of a symmetric matrix. */
static void rotate_sym(int arm, float m[6])
{
    static const int AT[3][3] = {{0, 3, 4}, {3, 1, 5}, {4, 5, 2}};
    const permutation_type *p = &PERMUTATIONS[arm];
    const matrix *r = &ARMS[arm].rotation;
    float old[6], rows[3][3];
    int i;
    memcpy(old, m, sizeof old);
    if (p->is) {
        for (i = 0; i < 3; i++) m[i] = old[p->place[i]];
        for (i = 3; i < 6; i++) {
            int x = ROWS[i], y = COLUMNS[i];
            m[i] = p->sign[x] * p->sign[y] * old[AT[p->place[x]][p->place[y]]];
        }
        return;
    }
    for (i = 0; i < 3; i++) sym_vec(old, r->row[i], rows[i]);
    for (i = 0; i < 6; i++) m[i] = dot(rows[ROWS[i]], r->row[COLUMNS[i]]);
}

/* Seen from the base, by which an arm stands. */
static void to_base(int arm, inertia_type *of)
{
    static const float ZERO[3] = {0.0f, 0.0f, 0.0f};
    const permutation_type *permutation = &PERMUTATIONS[arm];
    const float *p = ARMS[arm].position, *c = of->c;
    const matrix *r = &ARMS[arm].rotation;
    float old[3][3], first[3][3], second[3][3];
    int i, j;
    rotate_sym(arm, of->a);
    rotate_sym(arm, of->c);
    memcpy(old, of->b, sizeof old);
    if (permutation->is) {
        const int *place = permutation->place;
        const float *sign = permutation->sign;
        for (i = 0; i < 3; i++) {
            for (j = 0; j < 3; j++) of->b[i][j] = sign[i] * sign[j] * old[place[i]][place[j]];
        }
    } else {
        matrix b, turned;
        memcpy(b.row, old, sizeof old);
        mat_mat(r, &b, &turned);
        for (i = 0; i < 3; i++) mat_vec(r, turned.row[i], of->b[i]);
    }
    memcpy(old, of->b, sizeof old);
    for (j = 0; j < 3; j++) {
        const float columns[3][3] = {{c[0], c[3], c[4]}, {c[3], c[1], c[5]}, {c[4], c[5], c[2]}};
        const float column[3] = {old[0][j], old[1][j], old[2][j]};
        float moved[3];
        cross_add(p, columns[j], column, moved);
        for (i = 0; i < 3; i++) of->b[i][j] = moved[i];
    }
    for (j = 0; j < 3; j++) {
        cross_add(p, old[j], ZERO, first[j]);
        cross_add(p, of->b[j], ZERO, second[j]);
    }
    for (i = 0; i < 6; i++) of->a[i] += first[COLUMNS[i]][ROWS[i]] + second[ROWS[i]][COLUMNS[i]];
}

static void inverse_sym(const float m[6], float out[6])
{
    float xx = m[0], yy = m[1], zz = m[2], xy = m[3], xz = m[4], yz = m[5];
    float c_xx = fnma(yz, yz, yy * zz);
    float c_xy = fnma(xy, zz, xz * yz);
    float c_xz = fnma(xz, yy, xy * yz);
    float s = 1.0f / fma_(xz, c_xz, fma_(xy, c_xy, xx * c_xx));
    out[0] = s * c_xx;
    out[1] = s * fnma(xz, xz, xx * zz);
    out[2] = s * fnma(xy, xy, xx * yy);
    out[3] = s * c_xy;
    out[4] = s * c_xz;
    out[5] = s * fnma(yz, xx, xy * xz);
}

/* The motion that an inertia takes from a force. */
static void solve(const inertia_type *of, const vector_6 *force, vector_6 *motion)
{
    float c_inverse[6], inverse[6], schur[6], bc[3][3], moment[3], free[3];
    const float *ang = motion->angular;
    int i;
    inverse_sym(of->c, c_inverse);
    for (i = 0; i < 3; i++) sym_vec(c_inverse, of->b[i], bc[i]);
    for (i = 0; i < 6; i++) schur[i] = of->a[i] - dot(bc[ROWS[i]], of->b[COLUMNS[i]]);
    for (i = 0; i < 3; i++) moment[i] = force->angular[i] - dot(bc[i], force->linear);
    inverse_sym(schur, inverse);
    sym_vec(inverse, moment, motion->angular);
    sym_vec(c_inverse, force->linear, free);
    for (i = 0; i < 3; i++) {
        motion->linear[i] = free[i] - fma_(bc[2][i], ang[2], fma_(bc[1][i], ang[1], bc[0][i] * ang[0]));
    }
}

static void momentum(const body_type *body, const vector_6 *v, vector_6 *out)
{
    float rotor[3], straight[3];
    sym_vec(body->inertia, v->angular, rotor);
    cross_add(body->moment, v->linear, rotor, out->angular);
    times(body->mass, v->linear, straight);
    cross_add(v->angular, body->moment, straight, out->linear);
}

/* Adds an arm to the momentum of all, and to their inertia with the joints locked. */
static void add_arm(int arm, const vector_6 *base, const float *q, const float *qd, vector_6 *total, inertia_type *locked)
{
    const int n = ARM_JOINTS[arm].n, first_link = KINDS[ARMS[arm].kind].first_link;
    const link_type *links = &LINKS[first_link];
    const body_type *bodies = &BODIES[first_link];
    vector_6 v[OCTOPUS_ARM_JOINTS], h, own;
    inertia_type inertia;
    float sines[OCTOPUS_ARM_JOINTS], cosines[OCTOPUS_ARM_JOINTS], moved[3];
    const float *p = ARMS[arm].position;
    const matrix *r = &ARMS[arm].rotation;
    int i, j;
    for (j = 0; j < n; j++) {
        if (j == 0) {
            cross_add(base->angular, p, base->linear, moved);
            mat_t_vec(r, base->angular, v[0].angular);
            mat_t_vec(r, moved, v[0].linear);
        } else {
            const link_type *before = &links[j - 1];
            const float *angular = v[j - 1].angular;
            memcpy(moved, v[j - 1].linear, sizeof moved);
            if (before->has_a) {
                moved[1] = fma_(angular[2], before->a, moved[1]);
                moved[2] = fnma(angular[1], before->a, moved[2]);
            }
            if (before->has_d) {
                moved[0] = fma_(angular[1], before->d, moved[0]);
                moved[1] = fnma(angular[0], before->d, moved[1]);
            }
            untwist(before, angular, v[j].angular);
            untwist(before, moved, v[j].linear);
        }
        sin_cos(q[j], &sines[j], &cosines[j]);
        unturn(sines[j], cosines[j], v[j].angular);
        unturn(sines[j], cosines[j], v[j].linear);
        v[j].angular[2] += qd[j];
    }
    memset(&inertia, 0, sizeof inertia);
    memset(&h, 0, sizeof h);
    for (j = n - 1; j >= 0; j--) {
        const link_type *link = &links[j];
        if (j < n - 1) {
            to_previous(link, &inertia);
            twist(link, h.angular, own.angular);
            twist(link, h.linear, own.linear);
            h = own;
            if (link->has_a) {
                h.angular[1] = fnma(link->a, h.linear[2], h.angular[1]);
                h.angular[2] = fma_(link->a, h.linear[1], h.angular[2]);
            }
            if (link->has_d) {
                h.angular[0] = fnma(link->d, h.linear[1], h.angular[0]);
                h.angular[1] = fma_(link->d, h.linear[0], h.angular[1]);
            }
        }
        add_body(&inertia, &bodies[j]);
        momentum(&bodies[j], &v[j], &own);
        turn_sym(sines[j], cosines[j], inertia.a);
        turn_mat(sines[j], cosines[j], inertia.b);
        turn_sym(sines[j], cosines[j], inertia.c);
        plus(h.angular, own.angular, h.angular);
        plus(h.linear, own.linear, h.linear);
        turn(sines[j], cosines[j], h.angular);
        turn(sines[j], cosines[j], h.linear);
    }
    to_base(arm, &inertia);
    for (i = 0; i < 6; i++) {
        locked->a[i] += inertia.a[i];
        locked->c[i] += inertia.c[i];
    }
    for (i = 0; i < 9; i++) locked->b[i / 3][i % 3] += inertia.b[i / 3][i % 3];
    mat_vec(r, h.linear, own.linear);
    mat_vec(r, h.angular, moved);
    cross_add(p, own.linear, moved, own.angular);
    plus(total->angular, own.angular, total->angular);
    plus(total->linear, own.linear, total->linear);
}

/* Velocity that the base, which has none, takes so that no momentum is left: its axes. */
static void recoil(const place_type *place, const float qd[OCTOPUS_JOINTS], vector_6 *motion)
{
    static const float ZERO[3] = {0.0f, 0.0f, 0.0f};
    inertia_type locked;
    vector_6 base, total, force;
    float linear[3], angular[3], moment[3];
    int arm;
    memset(&locked, 0, sizeof locked);
    memset(&base, 0, sizeof base);
    mat_t_vec(&place->rotation, ZERO, base.linear);
    add_body(&locked, &BASE);
    momentum(&BASE, &base, &total);
    for (arm = 0; arm < OCTOPUS_ARMS; arm++) {
        const int first = ARM_JOINTS[arm].first;
        add_arm(arm, &base, &place->angles[first], &qd[first], &total, &locked);
    }
    mat_vec(&place->rotation, total.linear, linear);
    mat_vec(&place->rotation, total.angular, moment);
    cross_add(ZERO, linear, moment, angular);
    minus(ZERO, angular, angular);
    minus(ZERO, linear, linear);
    mat_t_vec(&place->rotation, angular, force.angular);
    mat_t_vec(&place->rotation, linear, force.linear);
    solve(&locked, &force, motion);
}

/* -- what touches -- */

static void middle_of(const float from[3], const float to[3], float out[3])
{
    plus(from, to, out);
    times(0.5f, out, out);
}

static void put_point(const frame_type *pose, const float p[3], float out[3])
{
    float v[3];
    mat_vec(&pose->rotation, p, v);
    plus(v, pose->position, out);
}

static void put_shape(const frame_type *pose, const shape_type *shape, shape_type *out)
{
    *out = *shape;
    put_point(pose, shape->a, out->a);
    if (shape->is_cylinder) mat_vec(&pose->rotation, shape->b, out->b);
    else put_point(pose, shape->b, out->b);
}

static void bound_of(const shape_type *shape, capsule_type *bound)
{
    if (shape->is_cylinder) {
        times_plus(-shape->cylinder_half, shape->b, shape->a, bound->from);
        times_plus(shape->cylinder_half, shape->b, shape->a, bound->to);
        bound->radius = shape->cylinder_radius + shape->radius;
    } else {
        memcpy(bound->from, shape->a, sizeof shape->a);
        memcpy(bound->to, shape->b, sizeof shape->b);
        bound->radius = shape->radius;
    }
}

/* Closest points of two segments, in the middle of the overlap where they are parallel. */
static void segment_segment(const float p0[3], const float p1[3], const float q0[3], const float q1[3], float p[3], float q[3])
{
    float d1[3], d2[3], r[3];
    float a, e, b, c, f, denominator, t0, t1, low, high, s, t;
    int skew;
    minus(p1, p0, d1);
    minus(q1, q0, d2);
    minus(p0, q0, r);
    a = maximum(dot(d1, d1), F(1e-12));
    e = maximum(dot(d2, d2), F(1e-12));
    b = dot(d1, d2);
    c = dot(d1, r);
    f = dot(d2, r);
    denominator = fnma(b, b, a * e);
    skew = denominator > F(1e-4) * (a * e);
    t0 = -c / a;
    t1 = (b - c) / a;
    low = clamp(minimum(t0, t1), 0.0f, 1.0f);
    high = clamp(maximum(t0, t1), 0.0f, 1.0f);
    s = fnma(c, e, b * f) / (skew ? denominator : 1.0f);
    s = skew ? clamp(s, 0.0f, 1.0f) : 0.5f * (low + high);
    t = clamp(fma_(b, s, f) / e, 0.0f, 1.0f);
    s = clamp(fma_(b, t, -c) / a, 0.0f, 1.0f);
    times_plus(s, d1, p0, p);
    times_plus(t, d2, q0, q);
}

static float between_capsules(const capsule_type *a, const capsule_type *b)
{
    float p[3], q[3];
    segment_segment(a->from, a->to, b->from, b->to, p, q);
    return distance(p, q) - (a->radius + b->radius);
}

static void to_box(const box_type *box, const float p[3], float out[3])
{
    float d[3];
    minus(p, box->centre, d);
    mat_t_vec(&box->rotation, d, out);
}

static void clamp_to_box(const float p[3], const float half[3], float out[3])
{
    int i;
    for (i = 0; i < 3; i++) out[i] = clamp(p[i], -half[i], half[i]);
}

/* A distance that a capsule is not below from a box. */
static float capsule_to_box(const capsule_type *a, const box_type *box)
{
    float p[3], q[3], e[3];
    int i;
    to_box(box, a->from, p);
    to_box(box, a->to, q);
    for (i = 0; i < 3; i++) {
        float beyond = minimum(p[i], q[i]) - box->half[i];
        float before = -box->half[i] - maximum(p[i], q[i]);
        e[i] = maximum(maximum(beyond, before), 0.0f);
    }
    return length(e) - a->radius;
}

/* Nearest point of the segment or cylinder of a shape. */
static void project(const shape_type *shape, const float p[3], float out[3])
{
    float d[3], r[3];
    if (shape->is_cylinder) {
        float z, rho, shrink, radial[3], on_axis[3];
        minus(p, shape->a, r);
        z = dot(r, shape->b);
        times_plus(-z, shape->b, r, radial);
        rho = length(radial);
        shrink = shape->cylinder_radius / maximum(rho, shape->cylinder_radius);
        times_plus(clamp(z, -shape->cylinder_half, shape->cylinder_half), shape->b, shape->a, on_axis);
        times_plus(shrink, radial, on_axis, out);
    } else {
        float square;
        minus(shape->b, shape->a, d);
        square = maximum(dot(d, d), F(1e-12));
        minus(p, shape->a, r);
        times_plus(clamp(dot(r, d) / square, 0.0f, 1.0f), d, shape->a, out);
    }
}

static void middle_of_shape(const shape_type *shape, float out[3])
{
    if (shape->is_cylinder) memcpy(out, shape->a, sizeof shape->a);
    else middle_of(shape->a, shape->b, out);
}

/* Distance of two shapes. */
static float between_shapes(const shape_type *a, const shape_type *b)
{
    float p[3], q[3];
    int pass;
    if (!a->is_cylinder && !b->is_cylinder) {
        segment_segment(a->a, a->b, b->a, b->b, p, q);
    } else {
        middle_of_shape(b, q);
        for (pass = 0; pass < 6; pass++) {
            project(a, q, p);
            project(b, p, q);
        }
    }
    return distance(p, q) - (a->radius + b->radius);
}

/* Half the derivative of the squared distance to a box along from + t d. */
static float slope(const float from[3], const float d[3], const float half[3], float t)
{
    float p[3], inside[3];
    times_plus(t, d, from, p);
    clamp_to_box(p, half, inside);
    minus(p, inside, p);
    return dot(p, d);
}

/* The point of a segment that is nearest to a box about the origin. */
static void segment_to_box(const float from[3], const float to[3], const float half[3], float out[3])
{
    float d[3], low = 0.0f, high = 1.0f, g_low, g_high, rise, share, t;
    int axis, side, linear;
    minus(to, from, d);
    g_low = slope(from, d, half, 0.0f);
    g_high = slope(from, d, half, 1.0f);
    for (axis = 0; axis < 3; axis++) {
        float inverse = 1.0f / (absolute(d[axis]) > F(1e-9) ? d[axis] : 1.0f);
        for (side = 0; side < 2; side++) {
            float face = side == 0 ? half[axis] : -half[axis], g;
            t = clamp((face - from[axis]) * inverse, 0.0f, 1.0f);
            g = slope(from, d, half, t);
            if (g <= 0.0f && t > low) {
                low = t;
                g_low = g;
            }
            if (g >= 0.0f && t < high) {
                high = t;
                g_high = g;
            }
        }
    }
    rise = g_high - g_low;
    linear = rise > F(1e-9);
    share = linear ? -g_low / rise : 0.5f;
    t = fma_(clamp(share, 0.0f, 1.0f), high - low, low);
    if (g_low > 0.0f) t = 0.0f;
    if (g_high < 0.0f) t = 1.0f;
    times_plus(t, d, from, out);
}

/* Distance of a shape and a box. */
static float shape_to_box(const shape_type *a, const box_type *box)
{
    float c[3], e[3], depth[3], outside, inside;
    int i, pass;
    if (a->is_cylinder) {
        shape_type turned = *a;
        to_box(box, a->a, turned.a);
        mat_t_vec(&box->rotation, a->b, turned.b);
        memcpy(c, turned.a, sizeof c);
        for (pass = 0; pass < 6; pass++) {
            clamp_to_box(c, box->half, e);
            project(&turned, e, c);
        }
    } else {
        float from[3], to[3];
        to_box(box, a->a, from);
        to_box(box, a->b, to);
        segment_to_box(from, to, box->half, c);
    }
    clamp_to_box(c, box->half, e);
    minus(c, e, e);
    outside = length(e);
    for (i = 0; i < 3; i++) depth[i] = absolute(c[i]) - box->half[i];
    inside = maximum(maximum(depth[0], depth[1]), depth[2]);
    return (outside > F(1e-5) ? outside : inside) - a->radius;
}

/* Links where they stand. */
typedef struct {
    frame_type poses[OCTOPUS_JOINTS];
    float sines[OCTOPUS_JOINTS], cosines[OCTOPUS_JOINTS];
    capsule_type bounds[OCTOPUS_JOINTS];
    float middles[OCTOPUS_JOINTS][3];
} scene_type;

static void put_links(const float q[OCTOPUS_JOINTS], scene_type *scene)
{
    int arm, i, j, within;
    for (arm = 0; arm < OCTOPUS_ARMS; arm++) {
        const int first_link = KINDS[ARMS[arm].kind].first_link;
        frame_type pose;
        pose.rotation = ARMS[arm].rotation;
        memcpy(pose.position, ARMS[arm].position, sizeof pose.position);
        for (within = 0; within < ARM_JOINTS[arm].n; within++) {
            const capsule_type *bound = &SOLIDS[first_link + within].bound;
            j = ARM_JOINTS[arm].first + within;
            sin_cos(q[j], &scene->sines[j], &scene->cosines[j]);
            for (i = 0; i < 3; i++) {
                float *row = pose.rotation.row[i], turned[3];
                if (within > 0) {
                    const link_type *before = &LINKS[first_link + within - 1];
                    if (before->has_a) pose.position[i] = fma_(before->a, row[0], pose.position[i]);
                    if (before->has_d) pose.position[i] = fma_(before->d, row[2], pose.position[i]);
                    untwist(before, row, turned);
                    memcpy(row, turned, sizeof turned);
                }
                unturn(scene->sines[j], scene->cosines[j], row);
            }
            scene->poses[j] = pose;
            put_point(&pose, bound->from, scene->bounds[j].from);
            put_point(&pose, bound->to, scene->bounds[j].to);
            scene->bounds[j].radius = bound->radius;
            middle_of(scene->bounds[j].from, scene->bounds[j].to, scene->middles[j]);
        }
    }
}

static int touches(const scene_type *scene, const pair_type *pair)
{
    const capsule_type *bound = &scene->bounds[pair->a];
    const solid_type *a = &SOLIDS[LINK_OF[pair->a]];
    const solid_type *b = pair->is_link ? &SOLIDS[LINK_OF[pair->b]] : &SOLIDS[OCTOPUS_LINKS + pair->b];
    int i, j;
    /* Balls and boxes first, then capsules around all, then closest points. */
    if (b->is_box) {
        if (!(capsule_to_box(bound, &b->box) < 0.0f)) return 0;
    } else {
        const capsule_type *other = pair->is_link ? &scene->bounds[pair->b] : &b->bound;
        float middle[3];
        middle_of(other->from, other->to, middle);
        if (!(distance(scene->middles[pair->a], middle) - pair->reach < 0.0f)) return 0;
        if (!pair->simple && !(between_capsules(bound, other) < 0.0f)) return 0;
    }
    for (i = 0; i < a->n; i++) {
        shape_type one;
        capsule_type around;
        put_shape(&scene->poses[pair->a], &SHAPES[a->first + i], &one);
        bound_of(&one, &around);
        if (b->is_box) {
            if (capsule_to_box(&around, &b->box) < 0.0f && shape_to_box(&one, &b->box) < 0.0f) return 1;
        }
        for (j = 0; j < b->n; j++) {
            shape_type other = SHAPES[b->first + j];
            capsule_type around_other;
            if (pair->is_link) put_shape(&scene->poses[pair->b], &SHAPES[b->first + j], &other);
            if (one.is_cylinder || other.is_cylinder) {
                bound_of(&other, &around_other);
                if (!(between_capsules(&around, &around_other) < 0.0f)) continue;
            }
            if (between_shapes(&one, &other) < 0.0f) return 1;
        }
    }
    return 0;
}

/* Number of pairs of bodies that touch. */
static int count_contacts(const float q[OCTOPUS_JOINTS])
{
    scene_type scene;
    int i, arm, n = 0;
    put_links(q, &scene);
    for (arm = 0; arm < OCTOPUS_ARMS; arm++) {
        const range_type *contacts = &CONTACTS_OF[ARMS[arm].kind];
        const int first = ARM_JOINTS[arm].first;
        for (i = contacts->first; i < contacts->end; i++) {
            const angle_contact_type *contact = &ANGLE_CONTACTS[i];
            int narrowing = first + contact->narrowing_joint;
            float sine = scene.sines[narrowing];
            float x = nearest_turn(q[first + contact->joint] - contact->centre);
            float half = fnma(contact->narrowing, absolute((sine + sine) * scene.cosines[narrowing]), contact->half);
            n += absolute(x) <= half;
        }
    }
    for (i = 0; i < OCTOPUS_PAIRS; i++) n += touches(&scene, &PAIRS[i]);
    return n;
}

/* -- where all arms end -- */

/* The attitude after a time at an angular velocity in its own axes. */
static void turn_by(const float attitude[4], float time, const float angular[3], float out[4])
{
    float phi[3], angle, sine, k, s, aw, ax, ay, az, bw, bx, by, bz, q[4];
    int i;
    times(time, angular, phi);
    angle = length(phi);
    sin_cos(0.5f * angle, &sine, &bw);
    k = angle < F(1e-4) ? fma_(angle * angle, F(-1.0 / 48.0), 0.5f) : sine / angle;
    bx = k * phi[0]; by = k * phi[1]; bz = k * phi[2];
    aw = attitude[0]; ax = attitude[1]; ay = attitude[2]; az = attitude[3];
    q[0] = fnma(az, bz, fnma(ay, by, fnma(ax, bx, aw * bw)));
    q[1] = fnma(az, by, fma_(ay, bz, fma_(ax, bw, aw * bx)));
    q[2] = fnma(ax, bz, fma_(az, bx, fma_(ay, bw, aw * by)));
    q[3] = fnma(ay, bx, fma_(ax, by, fma_(az, bw, aw * bz)));
    s = 1.0f / sqrtf(fma_(q[3], q[3], fma_(q[2], q[2], fma_(q[1], q[1], q[0] * q[0]))));
    for (i = 0; i < 4; i++) out[i] = q[i] * s;
}

/* Has all arms go to their postures, which follow the base on the way; how many pairs touch on it, control step by
 * control step, and by how much postures miss their goals at the end. Joints go as they are guided, the base goes as no
 * momentum lets it. */
static float play(const reading_type *reading, const place_type *from, octopus_posture postures[OCTOPUS_ARMS],
                  float misses[OCTOPUS_ARMS])
{
    place_type place = *from;
    float qd[OCTOPUS_JOINTS], touched = 0.0f;
    int step, arm, j;
    for (step = 0;; step++) {
        vector_6 v;
        float attitude[4], moved[3];
        matrix middle;
        for (arm = 0; arm < OCTOPUS_ARMS; arm++) {
            follow(arm, &postures[arm], reading->hand_goals[arm], &place, 0);
            j = ARM_JOINTS[arm].first;
            rates(arm, &postures[arm], OCTOPUS_PACE, &PACE_LIMITS[j], &qd[j]);
        }
        if (step == 15) break;
        for (j = 0; j < OCTOPUS_JOINTS; j++) place.angles[j] = fma_(0.5f * PERIOD, qd[j], place.angles[j]);
        recoil(&place, qd, &v);
        for (j = 0; j < OCTOPUS_JOINTS; j++) place.angles[j] = fma_(0.5f * PERIOD, qd[j], place.angles[j]);
        turn_by(place.attitude, 0.5f * PERIOD, v.angular, attitude);
        quaternion_to_rotation(attitude, &middle);
        mat_vec(&middle, v.linear, moved);
        times_plus(PERIOD, moved, place.position, place.position);
        turn_by(place.attitude, PERIOD, v.angular, attitude);
        memcpy(place.attitude, attitude, sizeof attitude);
        quaternion_to_rotation(place.attitude, &place.rotation);
        touched += (float)count_contacts(place.angles);
    }
    for (arm = 0; arm < OCTOPUS_ARMS; arm++) {
        frame_type target;
        seen_from(&place, reading->hand_goals[arm], &target);
        misses[arm] = approach(arm, &target, postures[arm].angles, NULL);
    }
    return touched;
}

/* Sets of ways that are tried, in rounds. */
#define ROUND 16
#define SETS (5 * ROUND)

/* Whether an arm takes another way in a set than in the best one before its round: all do in the first round and in every second set, one or
 * two in the others. */
static int is_varied(int set, int arm)
{
    int turn = set / 2;
    if (set == 0) return 0;
    return set < ROUND || set % 2 == 0 || arm == turn % OCTOPUS_ARMS || arm == turn / OCTOPUS_ARMS % OCTOPUS_ARMS;
}

/* Gives every arm that is `open` the way with which most of them arrive, and of such ways the shortest, or one
 * with which the others come nearer. An arm that has no way may go elsewhere, where that brings others to their goals.
 * `before`: how often ways were chosen for these goals already. */
static void foresee(const reading_type *reading, const place_type *place, const int open[OCTOPUS_ARMS], float before,
                    octopus_posture postures[OCTOPUS_ARMS])
{
    float best[OCTOPUS_ARMS][OCTOPUS_ARM_JOINTS], next[OCTOPUS_ARMS][OCTOPUS_ARM_JOINTS];
    float next_cost = from_bits(0x7f800000u);
    int set, arm;
    for (arm = 0; arm < OCTOPUS_ARMS; arm++) memcpy(next[arm], postures[arm].angles, sizeof next[arm]);
    for (set = 0; set < SETS; set++) {
        octopus_posture tried[OCTOPUS_ARMS];
        float first[OCTOPUS_ARMS][OCTOPUS_ARM_JOINTS], misses[OCTOPUS_ARMS], cost = 0.0f;
        if (set % ROUND == 0) memcpy(best, next, sizeof best);
        memcpy(tried, postures, sizeof tried);
        for (arm = 0; arm < OCTOPUS_ARMS; arm++) {
            const float *stands = &place->angles[ARM_JOINTS[arm].first];
            frame_type target;
            float of_way;
            seen_from(place, reading->hand_goals[arm], &target);
            memcpy(tried[arm].angles, best[arm], sizeof best[arm]);
            of_way = cost_of(arm, &target, stands, tried[arm].angles);
            if (open[arm] && is_varied(set, arm)) {
                float other[OCTOPUS_ARM_JOINTS], other_cost;
                float start = before * (float)(SETS * OCTOPUS_ARMS) + (float)(STARTS + 1 + set * OCTOPUS_ARMS + arm);
                later(arm, &target, start, other);
                other_cost = cost_of(arm, &target, stands, other);
                if (other_cost < STOPPED || (of_way >= UNSOLVED && other_cost < UNSOLVED + STOPPED)) {
                    copy_angles(arm, other, tried[arm].angles);
                    of_way = other_cost;
                }
            }
            cost += of_way < STOPPED ? of_way : 0.0f;
            memcpy(first[arm], tried[arm].angles, sizeof first[arm]);
        }
        cost += play(reading, place, tried, misses) * 20.0f;
        for (arm = 0; arm < OCTOPUS_ARMS; arm++) {
            if (tried[arm].good < 1.0f) cost += 100.0f + F(0.1) * misses[arm];
        }
        if (cost < next_cost) {
            next_cost = cost;
            memcpy(next, first, sizeof next);
        }
    }
    for (arm = 0; arm < OCTOPUS_ARMS; arm++) {
        if (open[arm]) memcpy(postures[arm].angles, next[arm], sizeof next[arm]);
    }
}

/* Also false for what is not a number. */
static int same(const float *a, const float *b, int n)
{
    int i;
    for (i = 0; i < n; i++) {
        if (!(a[i] == b[i])) return 0;
    }
    return 1;
}

/* Whether a goal is not far from where it was: then it is followed. Also false for what is not a number. */
static int is_near(const float goal[6], const float was[6])
{
    static const float NEAR[2] = {F(0.05), F(0.1)};
    int i;
    for (i = 0; i < 6; i++) {
        if (!(absolute(goal[i] - was[i]) < NEAR[i / 3])) return 0;
    }
    return 1;
}

/* Takes in where the base is read to be, unless it `rests`, and puts where it is taken to be into `place`: an exponential moving average,
 * so that the goals of a robot whose sensors err do not tremble. */
static void believe(float believed[7], int rests, place_type *place)
{
    float now[7], along, s;
    int i, known = believed[0] <= believed[0];
    if (!(OCTOPUS_TRUST < 1.0f)) return;
    memcpy(now, place->position, sizeof place->position);
    memcpy(now + 3, place->attitude, sizeof place->attitude);
    /* An attitude has two quaternions. */
    along = fma_(believed[6], now[6], fma_(believed[5], now[5], fma_(believed[4], now[4], believed[3] * now[3])));
    if (along < 0.0f) for (i = 3; i < 7; i++) now[i] = -now[i];
    if (known) for (i = 0; i < 7; i++) now[i] = fma_(OCTOPUS_TRUST, now[i] - believed[i], believed[i]);
    s = 1.0f / sqrtf(fma_(now[6], now[6], fma_(now[5], now[5], fma_(now[4], now[4], now[3] * now[3]))));
    for (i = 3; i < 7; i++) now[i] = now[i] * s;
    if (!rests) memcpy(believed, now, sizeof now);
    memcpy(place->position, believed, sizeof place->position);
    memcpy(place->attitude, believed + 3, sizeof place->attitude);
    quaternion_to_rotation(place->attitude, &place->rotation);
}

/* Counts a control step, unless the robot `rests` or a goal is `new_goal`; whether all arms choose anew: every tenth step where an arm has no
 * way to its goal or bodies touch, sixteen times. */
static int is_reviewed(octopus_memory *memory, int new_goal, int rests, const float angles[OCTOPUS_JOINTS])
{
    float reviews;
    int arm, bad;
    if (new_goal) memory->age = 0.0f;
    else if (!rests) memory->age = memory->age + 1.0f;
    reviews = floorf(memory->age / 10.0f);
    if (new_goal || rests || !(memory->age - reviews * 10.0f < 0.5f && reviews <= 16.0f)) return 0;
    bad = count_contacts(angles) > 0;
    for (arm = 0; arm < OCTOPUS_ARMS; arm++) bad |= memory->postures[arm].good < 1.0f;
    return bad;
}

/* Looks for postures of new goals, and has the others follow their goals and the base. */
static void look(const reading_type *reading, octopus_memory *memory)
{
    place_type place;
    float now[7];
    int open[OCTOPUS_ARMS], still[OCTOPUS_ARMS];
    int arm, rests, reviewed, any = 0;
    memcpy(place.position, reading->base_position, sizeof place.position);
    memcpy(place.attitude, reading->base_attitude, sizeof place.attitude);
    memcpy(place.angles, reading->joint_angles, sizeof place.angles);
    place.rotation = reading->base_rotation;
    memcpy(now, place.position, sizeof place.position);
    memcpy(now + 3, place.attitude, sizeof place.attitude);
    rests = same(now, memory->base, 7);
    memcpy(memory->base, now, sizeof now);
    believe(memory->believed, rests, &place);
    for (arm = 0; arm < OCTOPUS_ARMS; arm++) {
        octopus_posture *posture = &memory->postures[arm];
        open[arm] = !is_near(reading->hand_goals[arm], posture->goal);
        still[arm] = same(reading->hand_goals[arm], posture->goal, 6);
        if (open[arm]) {
            frame_type target;
            seen_from(&place, reading->hand_goals[arm], &target);
            search(arm, &target, &place.angles[ARM_JOINTS[arm].first], posture->angles);
            posture->tried = (float)STARTS;
            any = 1;
        }
        memcpy(posture->goal, reading->hand_goals[arm], sizeof posture->goal);
    }
    reviewed = is_reviewed(memory, any, rests, place.angles);
    for (arm = 0; reviewed && arm < OCTOPUS_ARMS; arm++) open[arm] = 1;
    if (any || reviewed) foresee(reading, &place, open, memory->age / 10.0f, memory->postures);
    for (arm = 0; arm < OCTOPUS_ARMS; arm++) {
        follow(arm, &memory->postures[arm], reading->hand_goals[arm], &place, rests && still[arm]);
    }
}

/* What is left to the posture of an arm, as both of its agents see it. */
static float *put_posture(float *out, const octopus_posture *posture)
{
    int j;
    *out++ = posture->good;
    *out++ = posture->free;
    /* Behind the last joint of a shorter arm nothing is left. */
    for (j = 0; j < OCTOPUS_ARM_JOINTS; j++) {
        out[j] = posture->left[j];
        out[OCTOPUS_ARM_JOINTS + j] = hyperbolic_tangent(posture->left[j] * F(1.0 / 0.1));
    }
    return out + 2 * OCTOPUS_ARM_JOINTS;
}

/* The controller of a space robot, in C99: state and goals in, joint rates out.
 *
 *     octopus_memory memory;
 *     double command[OCTOPUS_JOINTS];
 *     octopus_controller_reset(&memory);
 *     once every OCTOPUS_CONTROL_PERIOD seconds:
 *         octopus_status status = octopus_controller_step(&state, &goals, &memory, command);
 *
 * Allocates nothing, has no state of its own, and needs of the C library fmaf, sqrtf, rintf, floorf,
 * memcpy and memset alone (link with -lm). contract.toml says what every number is and what the controller must not be used for.
 */
#ifndef OCTOPUS_CONTROLLER_H
#define OCTOPUS_CONTROLLER_H

#ifdef __cplusplus
extern "C" {
#endif

@DEFINITIONS@

/* The robot as its sensors tell it. Arrays of joints go arm after arm. */
typedef struct {
    double base_position[3];         /* origin of the base, world (m) */
    double base_attitude[4];         /* unit quaternion (w, x, y, z), base to world */
    double base_velocity[3];         /* of the base's origin, world axes (m/s) */
    double base_angular_velocity[3]; /* in axes of the base (rad/s) */
    double joint_angles[OCTOPUS_JOINTS]; /* (rad) */
    double joint_rates[OCTOPUS_JOINTS];  /* (rad/s) */
} octopus_state;

/* Where the robot shall go. Goals that move are where they are at the time of the step. */
typedef struct {
#if OCTOPUS_TASK & OCTOPUS_TRAJECTORY
    double hands[OCTOPUS_ARMS][6]; /* position in the world (m), Euler angles a, b, c of Rx(a) Ry(b) Rz(c) (rad);
                                    * those of an arm that turns the base are not looked at */
#endif
#if OCTOPUS_TASK & OCTOPUS_MOVING
    double hand_velocities[OCTOPUS_ARMS][6]; /* of these goals now: linear (m/s), angular (rad/s), world axes */
#endif
#if OCTOPUS_TASK & OCTOPUS_REORIENTATION
    double base[3]; /* Euler angles a, b, c of Rx(a) Ry(b) Rz(c) (rad), base to world */
#endif
} octopus_goals;

#if OCTOPUS_POSTURES
/* The goal posture of an arm: joint angles that bring its hand to its goal. */
typedef struct {
    float goal[6];                    /* the goal that it was looked for; not a number where there is none */
    float angles[OCTOPUS_ARM_JOINTS]; /* (rad) */
    float left[OCTOPUS_ARM_JOINTS];   /* what is left to go there, each joint (rad) */
    float good;                       /* 1 if it brings the hand to its goal and stops no joint, else 0 */
    float free;                       /* 1 if it stops no joint, else 0 */
    float tried;                      /* starts from which it was looked for */
} octopus_posture;
#endif

/* What the controller remembers from one step to the next: its last actions, and goal postures if it has them. */
typedef struct {
    float action[OCTOPUS_JOINTS];
#if OCTOPUS_POSTURES
    octopus_posture postures[OCTOPUS_ARMS];
    float base[7];     /* where the base was read to be when they last followed it */
    float believed[7]; /* where it is taken to be */
    float age;         /* control steps since a goal was new */
#endif
} octopus_memory;

typedef enum {
    OCTOPUS_OK = 0,
    OCTOPUS_NULL = 1,               /* a pointer is null */
    OCTOPUS_STATE_NOT_FINITE = 2,   /* a number of the state is NaN, infinite or beyond a million */
    OCTOPUS_ATTITUDE_NOT_UNIT = 3,  /* the quaternion's square is off one by more than 0.001 */
    OCTOPUS_ANGLE_TOO_LARGE = 4,    /* a joint angle is beyond 1,000 rad */
    OCTOPUS_GOAL_NOT_FINITE = 5,    /* a number of the goals is NaN, infinite or beyond a million; an angle beyond 1,000 rad */
    OCTOPUS_GOAL_OUT_OF_REACH = 6,  /* a hand's goal is farther from its arm's mount than the arm is long */
    OCTOPUS_NO_NUMBER = 7           /* the networks gave no number */
} octopus_status;

/* Before the first step, and whenever the joints stood still: no last action. */
void octopus_controller_reset(octopus_memory *memory);

/* Joint rates (rad/s) to hold for OCTOPUS_CONTROL_PERIOD.
 *
 * After anything but OCTOPUS_OK all commands are zero, which holds the joints, and the memory is reset. */
octopus_status octopus_controller_step(const octopus_state *state, const octopus_goals *goals,
                                       octopus_memory *memory, double command[OCTOPUS_JOINTS]);

/* What the agents see, agent after agent, as the networks take it; for those who compare. */
octopus_status octopus_observe(const octopus_state *state, const octopus_goals *goals,
                               const octopus_memory *memory,
                               float observations[OCTOPUS_AGENTS * OCTOPUS_OBSERVATION]);

#if OCTOPUS_POSTURES
/* Goal postures alone, for those who run controller.onnx, which does not look for them: its input `postures`.
 * For each arm: good, free and left of its posture, zeros behind the last joint of a shorter arm. Call it once every control step, or octopus_controller_step,
 * with a memory that was reset before the first one. A step in which a goal is new, or ways are chosen anew, takes longer than others. */
octopus_status octopus_postures(const octopus_state *state, const octopus_goals *goals,
                                octopus_memory *memory, float postures[OCTOPUS_ARMS][OCTOPUS_POSTURE_NUMBERS]);
#endif

/* The robot at home, at rest: where every episode of an evaluation begins. */
octopus_state octopus_home(void);

/* Goals that are reached there, to make others from. */
octopus_goals octopus_home_goals(void);

/* A status in words. */
const char *octopus_status_text(octopus_status status);

#ifdef __cplusplus
}
#endif
#endif

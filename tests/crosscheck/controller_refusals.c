/* What an exported controller of a task whose hands have goals does with what it cannot act on. */
#include "controller.h"

#include <math.h>
#include <stdio.h>

static int failures;

static void expect(const char *what, octopus_status wanted, const octopus_state *state, const octopus_goals *goals)
{
    octopus_memory memory;
    double command[OCTOPUS_JOINTS];
    octopus_status found;
    int joint, held = 1, forgotten = 1;
    octopus_controller_reset(&memory);
    for (joint = 0; joint < OCTOPUS_JOINTS; joint++) {
        memory.action[joint] = 0.5f;
        command[joint] = 7.0;
    }
    found = octopus_controller_step(state, goals, &memory, command);
    for (joint = 0; joint < OCTOPUS_JOINTS; joint++) {
        held = held && command[joint] == 0.0;
        forgotten = forgotten && memory.action[joint] == 0.0f;
    }
    if (found != wanted || held != (wanted != OCTOPUS_OK) || forgotten != (wanted != OCTOPUS_OK)) {
        printf("%s: %s instead of %s\n", what, octopus_status_text(found), octopus_status_text(wanted));
        failures++;
    }
}

int main(void)
{
    const octopus_goals home = octopus_home_goals();
    octopus_state state = octopus_home();
    octopus_goals goals = home;
    octopus_memory memory;
    double command[OCTOPUS_JOINTS] = {0.0};
    double *numbers[] = {state.base_position,         state.base_attitude, state.base_velocity,
                         state.base_angular_velocity, state.joint_angles,  state.joint_rates};
    const double wrong[] = {NAN, INFINITY, -INFINITY, 1e7, -1e300};
    size_t i, j;
    expect("home", OCTOPUS_OK, &state, &home);
    for (i = 0; i < sizeof numbers / sizeof *numbers; i++) {
        for (j = 0; j < sizeof wrong / sizeof *wrong; j++) {
            const double was = numbers[i][1];
            numbers[i][1] = wrong[j];
            expect("a number of the state", OCTOPUS_STATE_NOT_FINITE, &state, &home);
            numbers[i][1] = was;
        }
    }
    state.base_attitude[0] = 0.0;
    expect("no attitude", OCTOPUS_ATTITUDE_NOT_UNIT, &state, &home);
    state.base_attitude[0] = 1.01;
    expect("a long quaternion", OCTOPUS_ATTITUDE_NOT_UNIT, &state, &home);
    state.base_attitude[0] = 0.99;
    expect("a short quaternion", OCTOPUS_ATTITUDE_NOT_UNIT, &state, &home);
    state.base_attitude[0] = -1.0;
    expect("the other sign", OCTOPUS_OK, &state, &home);
    state = octopus_home();
    state.joint_angles[OCTOPUS_JOINTS - 1] = 1001.0;
    expect("wound up", OCTOPUS_ANGLE_TOO_LARGE, &state, &home);
    state.joint_angles[OCTOPUS_JOINTS - 1] = -900.0;
    expect("wound up less", OCTOPUS_OK, &state, &home);
    state = octopus_home();
    goals.hands[0][0] = INFINITY;
    expect("an infinite goal", OCTOPUS_GOAL_NOT_FINITE, &state, &goals);
    goals = home;
    goals.hands[0][3] = 2000.0;
    expect("a turned goal", OCTOPUS_GOAL_NOT_FINITE, &state, &goals);
    goals = home;
    goals.hands[0][0] += 3.0;
    expect("a far goal", OCTOPUS_GOAL_OUT_OF_REACH, &state, &goals);
    goals.hands[0][0] = 1e6;
    expect("a very far goal", OCTOPUS_GOAL_OUT_OF_REACH, &state, &goals);
#if OCTOPUS_TASK & OCTOPUS_MOVING
    goals = home;
    goals.hand_velocities[OCTOPUS_ARMS - 1][4] = NAN;
    expect("a goal that moves by nothing", OCTOPUS_GOAL_NOT_FINITE, &state, &goals);
    goals.hand_velocities[OCTOPUS_ARMS - 1][4] = 2e6;
    expect("a goal that is too fast", OCTOPUS_GOAL_NOT_FINITE, &state, &goals);
#endif
#if OCTOPUS_TASK & OCTOPUS_REORIENTATION
    goals = home;
    goals.base[1] = INFINITY;
    expect("an infinite goal of the base", OCTOPUS_GOAL_NOT_FINITE, &state, &goals);
    /* Arms of the second half turn the base; their hands have no goals. */
    goals = home;
    goals.hands[OCTOPUS_ARMS - 1][0] = NAN;
    expect("nothing where no goal is", OCTOPUS_OK, &state, &goals);
#else
    goals = home;
    goals.hands[OCTOPUS_ARMS - 1][5] = NAN;
    expect("no goal", OCTOPUS_GOAL_NOT_FINITE, &state, &goals);
#endif
    expect("no state", OCTOPUS_NULL, NULL, &home);
    expect("no goals", OCTOPUS_NULL, &state, NULL);
    if (octopus_controller_step(&state, &home, NULL, command) != OCTOPUS_NULL) failures++;
    if (octopus_controller_step(&state, &home, &memory, NULL) != OCTOPUS_NULL) failures++;
    if (octopus_observe(&state, &home, &memory, NULL) != OCTOPUS_NULL) failures++;
    if (failures == 0) printf("all as it should be\n");
    return failures != 0;
}

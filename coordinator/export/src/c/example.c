/* A program that uses the controller: it brings the robot from home to a goal.
 *
 *     cc -std=c99 -O2 -o example example.c controller.c -lm && ./example
 *
 * In place of a robot it has one whose joints follow their commands at once and whose base stands still. Where it says
 * SENSORS and SERVOS, a flight program reads and writes.
 */
#include "controller.h"

#include <stdio.h>

int main(void)
{
    octopus_state state = octopus_home();
    octopus_goals goals = octopus_home_goals();
    octopus_memory memory;
    double command[OCTOPUS_JOINTS];
    int step, joint;

#if OCTOPUS_TASK & OCTOPUS_TRAJECTORY
    goals.hands[0][0] += 0.05; /* m, along the world's x axis */
#endif
#if OCTOPUS_TASK & OCTOPUS_MOVING
    goals.hand_velocities[0][0] = -0.001; /* m/s, from there on */
#endif
#if OCTOPUS_TASK & OCTOPUS_REORIENTATION
    goals.base[2] += 0.1; /* rad */
#endif
    octopus_controller_reset(&memory);
    for (step = 0; step < 100; step++) {
        octopus_status status = octopus_controller_step(&state, &goals, &memory, command);
        if (status != OCTOPUS_OK) {
            fprintf(stderr, "step %d: %s\n", step, octopus_status_text(status));
            return 1;
        }
        /* SERVOS: hold the commands for OCTOPUS_CONTROL_PERIOD seconds. SENSORS: then read the state. */
        for (joint = 0; joint < OCTOPUS_JOINTS; joint++) {
            state.joint_rates[joint] = command[joint];
            state.joint_angles[joint] += command[joint] * OCTOPUS_CONTROL_PERIOD;
        }
#if OCTOPUS_TASK & OCTOPUS_MOVING
        /* Goals that move are told anew in every step. */
        goals.hands[0][0] += goals.hand_velocities[0][0] * OCTOPUS_CONTROL_PERIOD;
#endif
        if (step % 20 == 0) {
            double fastest = 0.0;
            for (joint = 0; joint < OCTOPUS_JOINTS; joint++) {
                double rate = command[joint] < 0.0 ? -command[joint] : command[joint];
                if (rate > fastest) fastest = rate;
            }
            printf("%5.1f s: fastest joint %.3f rad/s\n", step * OCTOPUS_CONTROL_PERIOD, fastest);
        }
    }
    return 0;
}

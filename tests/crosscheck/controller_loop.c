/* An exported controller for a simulator that asks: lines in, lines out.
 *
 * In: index of the robot, whether its episode begins, state, goals. Out: status, actions before scaling, commands.
 */
#include "controller.h"

#include <stdio.h>

#define ROBOTS 64

static int number(double *x) { return scanf("%lf", x) == 1; }

static int numbers(double *to, size_t n)
{
    size_t i;
    for (i = 0; i < n; i++) {
        if (!number(&to[i])) return 0;
    }
    return 1;
}

int main(void)
{
    static octopus_memory memories[ROBOTS];
    double index, begins;
    octopus_state state;
    octopus_goals goals;
    while (number(&index) && number(&begins) && numbers(state.base_position, 3) && numbers(state.base_attitude, 4)
           && numbers(state.base_velocity, 3) && numbers(state.base_angular_velocity, 3)
           && numbers(state.joint_angles, OCTOPUS_JOINTS) && numbers(state.joint_rates, OCTOPUS_JOINTS)
           && numbers((double *)&goals, sizeof goals / sizeof(double)) && index >= 0 && index < ROBOTS) {
        octopus_memory *memory = &memories[(int)index];
        double command[OCTOPUS_JOINTS];
        int joint;
        if (begins != 0.0) octopus_controller_reset(memory);
        printf("%d", (int)octopus_controller_step(&state, &goals, memory, command));
        for (joint = 0; joint < OCTOPUS_JOINTS; joint++) printf(" %.9g", (double)memory->action[joint]);
        for (joint = 0; joint < OCTOPUS_JOINTS; joint++) printf(" %.17g", command[joint]);
        printf("\n");
        fflush(stdout);
    }
    return 0;
}

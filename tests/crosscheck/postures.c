/* Goal postures of an exported controller for whoever has arrays instead of structs: one robot at a time.
 *
 *     cc -std=c99 -O2 -shared -fPIC -I DIRECTORY -o postures.so postures.c DIRECTORY/controller.c -lm
 */
#include "controller.h"

#include <string.h>

static octopus_memory memory;

/* An episode begins. */
void begin(void);
void begin(void) { octopus_controller_reset(&memory); }

/* OCTOPUS_POSTURE_NUMBERS numbers of each arm, with six of each goal; once every control step. Returns the status. */
int look(const double position[3], const double attitude[4], const double *angles, const double *hands, float *postures);
int look(const double position[3], const double attitude[4], const double *angles, const double *hands, float *postures)
{
    octopus_state state;
    octopus_goals goals;
    memset(&state, 0, sizeof state);
    memcpy(state.base_position, position, sizeof state.base_position);
    memcpy(state.base_attitude, attitude, sizeof state.base_attitude);
    memcpy(state.joint_angles, angles, sizeof state.joint_angles);
    memcpy(goals.hands, hands, sizeof goals.hands);
    return (int)octopus_postures(&state, &goals, &memory, (float (*)[OCTOPUS_POSTURE_NUMBERS])postures);
}

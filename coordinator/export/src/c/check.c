/* Holds controller.c against vectors.json, to the bit:
 *
 *     cc -std=c99 -O2 -o check check.c controller.c -lm && ./check vectors.json
 */
#include "controller.h"

#include <stdio.h>
#include <string.h>

#ifdef OCTOPUS_TIME
#include <time.h>
#endif

/* The next number of the file that stands in no name or text. */
static int next(FILE *file, double *number)
{
    int c;
    while ((c = fgetc(file)) != EOF) {
        if (c == '"') {
            while ((c = fgetc(file)) != EOF && c != '"') {
                if (c == '\\') (void)fgetc(file);
            }
        } else if (c == '-' || (c >= '0' && c <= '9')) {
            ungetc(c, file);
            return fscanf(file, "%lf", number) == 1;
        }
    }
    return 0;
}

static int read_doubles(FILE *file, double *to, size_t n)
{
    size_t i;
    for (i = 0; i < n; i++) {
        if (!next(file, &to[i])) return 0;
    }
    return 1;
}

/* To behind a word. */
static int find(FILE *file, const char *word)
{
    size_t matched = 0;
    int c;
    while (word[matched] && (c = fgetc(file)) != EOF) {
        matched = c == word[matched] ? matched + 1 : (size_t)(c == word[0]);
    }
    return !word[matched];
}

static octopus_state state;
static octopus_goals goals;
static double last_command[OCTOPUS_JOINTS], last_action[OCTOPUS_JOINTS], wanted[OCTOPUS_JOINTS];
static double seen[OCTOPUS_AGENTS * OCTOPUS_OBSERVATION];
#if OCTOPUS_POSTURES
static double begins, postures[OCTOPUS_ARMS][OCTOPUS_POSTURE_NUMBERS];
#endif

static int read_case(FILE *file)
{
    double *goal = (double *)&goals;
#if OCTOPUS_POSTURES
    if (!next(file, &begins)) return 0;
#endif
    return read_doubles(file, state.base_position, 3) && read_doubles(file, state.base_attitude, 4)
        && read_doubles(file, state.base_velocity, 3) && read_doubles(file, state.base_angular_velocity, 3)
        && read_doubles(file, state.joint_angles, OCTOPUS_JOINTS) && read_doubles(file, state.joint_rates, OCTOPUS_JOINTS)
        && read_doubles(file, last_command, OCTOPUS_JOINTS) && read_doubles(file, last_action, OCTOPUS_JOINTS)
        && read_doubles(file, goal, sizeof goals / sizeof *goal)
#if OCTOPUS_POSTURES
        && read_doubles(file, postures[0], OCTOPUS_ARMS * OCTOPUS_POSTURE_NUMBERS)
#endif
        && read_doubles(file, seen, OCTOPUS_AGENTS * OCTOPUS_OBSERVATION) && read_doubles(file, wanted, OCTOPUS_JOINTS);
}

static double difference(double a, double b) { return a > b ? a - b : b - a; }

int main(int argc, char **argv)
{
    FILE *file = fopen(argc > 1 ? argv[1] : "vectors.json", "r");
    int expected, cases = 0, other = 0, i;
    double worst_seen = 0.0, worst_command = 0.0;
    octopus_memory memory;
    octopus_controller_reset(&memory);
    if (!file || !find(file, "\"n_cases\":") || fscanf(file, "%d", &expected) != 1 || !find(file, "\"cases\":[")) {
        fprintf(stderr, "check: no vectors.json with states in it\n");
        return 2;
    }
    while (cases < expected && read_case(file)) {
        float observations[OCTOPUS_AGENTS * OCTOPUS_OBSERVATION];
        double command[OCTOPUS_JOINTS];
        octopus_status status;
        int same = 1;
#if OCTOPUS_POSTURES
        octopus_memory alone;
        float found[OCTOPUS_ARMS][OCTOPUS_POSTURE_NUMBERS];
        /* Each episode is whole from its beginning on, because postures are remembered. */
        if (begins != 0.0) octopus_controller_reset(&memory);
        alone = memory;
        octopus_postures(&state, &goals, &alone, found);
        for (i = 0; i < OCTOPUS_ARMS * OCTOPUS_POSTURE_NUMBERS; i++) {
            const int arm = i / OCTOPUS_POSTURE_NUMBERS, number = i % OCTOPUS_POSTURE_NUMBERS;
            same = same && found[arm][number] == (float)postures[arm][number];
        }
#endif
        for (i = 0; i < OCTOPUS_JOINTS; i++) memory.action[i] = (float)last_action[i];
        status = octopus_observe(&state, &goals, &memory, observations);
        if (status == OCTOPUS_OK) status = octopus_controller_step(&state, &goals, &memory, command);
        if (status != OCTOPUS_OK) {
            fprintf(stderr, "check: state %d: %s\n", cases, octopus_status_text(status));
            return 1;
        }
        for (i = 0; i < OCTOPUS_AGENTS * OCTOPUS_OBSERVATION; i++) {
            double off = difference(observations[i], (float)seen[i]);
            if (off > worst_seen) worst_seen = off;
            same = same && off == 0.0;
        }
        for (i = 0; i < OCTOPUS_JOINTS; i++) {
            double off = difference(command[i], (float)wanted[i]);
            if (off > worst_command) worst_command = off;
            same = same && off == 0.0;
        }
        other += !same;
        cases++;
    }
    fclose(file);
    printf("%d states, %d with other bits; largest difference of observations %g, of commands %g rad/s\n", cases, other,
           worst_seen, worst_command);
#ifdef OCTOPUS_TIME
    {
        /* The last state again and again, as if the base drifted. */
        double command[OCTOPUS_JOINTS];
        clock_t start = clock();
        for (i = 0; i < OCTOPUS_TIME; i++) {
            state.base_position[0] += i % 2 == 0 ? 1e-4 : -1e-4;
            octopus_controller_step(&state, &goals, &memory, command);
        }
        printf("%.1f us a step\n", 1e6 * (double)(clock() - start) / CLOCKS_PER_SEC / OCTOPUS_TIME);
#if OCTOPUS_POSTURES
        start = clock();
        for (i = 0; i < 10; i++) {
            octopus_controller_reset(&memory);
            octopus_controller_step(&state, &goals, &memory, command);
        }
        printf("%.1f us a step with new goals\n", 1e5 * (double)(clock() - start) / CLOCKS_PER_SEC);
#endif
    }
#endif
    if (cases == 0 || cases < expected) {
        fprintf(stderr, "check: the file ends after %d of %d states\n", cases, expected);
        return 2;
    }
    return other != 0;
}

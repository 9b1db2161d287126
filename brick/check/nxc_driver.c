/*
 * Answers those commands of brick/vectors that an NXT has, by the encoder of the NXC program compiled as C.
 *
 * What differs between the languages is put right here: NXC's long has 32 bits, its byte is unsigned. What nbc makes of
 * the same file is run by run_nxc.py.
 */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define byte uint8_t
#define long int
#include "posebridge_frames.nxc"
#undef long
#undef byte

#define MOST_NUMBERS 16

int main(void)
{
    static char line[1024];
    pb_make_table();
    while (fgets(line, sizeof line, stdin)) {
        long long numbers[MOST_NUMBERS] = {0};
        int count = 0, place;
        const char *command = strtok(line, " \n"), *found;
        if (!command)
            continue;
        while (count < MOST_NUMBERS && (found = strtok(NULL, " \n")) != NULL)
            numbers[count++] = strtoll(found, NULL, 10);
        pb_sequence = (uint8_t)numbers[0];
        pb_system = (uint8_t)numbers[1];
        pb_component = (uint8_t)numbers[2];
        if (strcmp(command, "turn") == 0) {
            pb_turn_urad = pb_turn_rest = 0;
            for (place = 0; place + 1 < count; place += 2)
                pb_add_turn((int)numbers[place], (int)numbers[place + 1]);
            printf("%d\n", pb_turn_urad);
            continue;
        }
        if (strcmp(command, "heartbeat") == 0)
            pb_make_heartbeat();
        else if (strcmp(command, "wheel_ticks") == 0)
            pb_make_wheel_ticks((uint32_t)numbers[3], (int32_t)numbers[4], (int32_t)numbers[5], (uint32_t)numbers[6]);
        else if (strcmp(command, "inertial") == 0)
            pb_make_inertial((uint32_t)numbers[3], (int32_t)numbers[4], (int32_t)numbers[5], (int32_t)numbers[6], (int32_t)numbers[7],
                (uint32_t)numbers[8]);
        else
            return 2;
        for (place = 0; place < pb_length; place++)
            printf("%02x", pb_frame[place]);
        printf("\n");
    }
    return 0;
}

/*
 * Runs steps.c on a simulated ATmega328P and counts what a step takes.
 *
 *   run_avr program.bin <words: check_ready check_before check_after check_in check_out add mul div sine cosine> < rows > answers
 *
 * Addresses are those of avr-nm, hexadecimal; 0 for a function that the program does not have. The last line is `cost`: the most cycles, the
 * most bytes of stack, and the most additions (subtractions among them), products, quotients, and sines of a step. What is done inside sine,
 * cosine and e^x is not counted as theirs.
 */
#include <avr_flash.h>
#include <sim_avr.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { READY, BEFORE, AFTER, IN, OUT, ADD, MUL, DIV, SINE, COSINE, EXP, WORDS };

static unsigned stack_of(avr_t *avr) { return avr->data[R_SPL] | avr->data[R_SPH] << 8; }

/* Runs to a function; returns 0 where the program has crashed or does not come there. */
static int run_to(avr_t *avr, unsigned address)
{
    avr_cycle_count_t limit = avr->cycle + 100000000u;
    do {
        int state = avr_run(avr);
        if (state == cpu_Done || state == cpu_Crashed || avr->cycle > limit) return 0;
    } while (avr->pc != address);
    return 1;
}

int main(int argc, char **argv)
{
    unsigned long word[WORDS] = {0}, most[6] = {0};
    static unsigned char flash[32768];
    double in[7];
    avr_t *avr = avr_make_mcu_by_name("atmega328p");
    FILE *program = argc > 1 ? fopen(argv[1], "rb") : NULL;
    size_t size;
    int i;

    if (avr == NULL || program == NULL || argc != WORDS + 2) return 2;
    for (i = 0; i < WORDS; i++) word[i] = strtoul(argv[i + 2], NULL, 16);
    size = fread(flash, 1, sizeof flash, program);
    avr_init(avr);
    avr->log = LOG_NONE;
    avr->frequency = 16000000;
    avr_loadcode(avr, flash, (avr_flashaddr_t)size, 0);
    avr->codeend = avr->flashend;
    if (!run_to(avr, word[READY])) return 3;
    while (scanf("%lf %lf %lf %lf %lf %lf %lf", &in[0], &in[1], &in[2], &in[3], &in[4], &in[5], &in[6]) == 7) {
        unsigned long cost[6] = {0};
        avr_cycle_count_t begun;
        unsigned top, inside = 0;
        float value;
        for (i = 0; i < 7; i++) {
            value = (float)in[i];
            memcpy(&avr->data[(word[IN] & 0xffff) + 4 * i], &value, 4);
        }
        if (!run_to(avr, word[BEFORE])) return 3;
        begun = avr->cycle;
        top = stack_of(avr);
        while (avr->pc != word[AFTER]) {
            int state = avr_run(avr);
            unsigned now = stack_of(avr);
            if (state == cpu_Done || state == cpu_Crashed) return 3;
            if (top > now && top - now > cost[1]) cost[1] = top - now;
            if (inside != 0 && now > inside) inside = 0;
            if (inside != 0) continue;
            if (avr->pc == word[ADD]) cost[2]++;
            if (avr->pc == word[MUL]) cost[3]++;
            if (avr->pc == word[DIV]) cost[4]++;
            if (word[SINE] == avr->pc || word[COSINE] == avr->pc || word[EXP] == avr->pc) {
                if (avr->pc != 0) {
                    cost[5]++;
                    inside = now;
                }
            }
        }
        cost[0] = (unsigned long)(avr->cycle - begun);
        for (i = 0; i < 6; i++)
            if (cost[i] > most[i]) most[i] = cost[i];
        /* The answer is there when the program waits for the next row. */
        if (!run_to(avr, word[READY])) return 3;
        for (i = 0; i < 5; i++) {
            memcpy(&value, &avr->data[(word[OUT] & 0xffff) + 4 * i], 4);
            printf("%.9g%c", (double)value, i < 4 ? ' ' : '\n');
        }
    }
    printf("cost %lu %lu %lu %lu %lu %lu\n", most[0], most[1], most[2], most[3], most[4], most[5]);
    return 0;
}

/*
 * Runs a program on a simulated Arduino Uno in real time, its serial port on a terminal.
 *
 *     run_uno program.bin SECONDS < TERMINAL > TERMINAL
 *
 * It begins with the first byte that it is sent, as an Uno does when its port is opened, and ends after that many seconds of its own time. A computer
 * that stands still for longer than a tenth of a second makes the Uno stand still, too.
 */
#include <avr_uart.h>
#include <poll.h>
#include <sim_avr.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>

enum { CLOCK_HZ = 16000000, SLICE_US = 1000, MOST_BEHIND_US = 100000 };

static int has_room = 1;

static void out(struct avr_irq_t *irq, uint32_t value, void *context)
{
    unsigned char byte = (unsigned char)value;
    (void)irq;
    (void)context;
    if (write(STDOUT_FILENO, &byte, 1) != 1) exit(4);
}

static void room(struct avr_irq_t *irq, uint32_t value, void *context)
{
    (void)irq;
    (void)value;
    has_room = context != NULL;
}

static int64_t now_us(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000000 + now.tv_nsec / 1000;
}

int main(int argc, char **argv)
{
    static unsigned char flash[32768], waiting[4096];
    size_t first = 0, end = 0, size;
    uint32_t flags = 0;
    int64_t ahead_us, begun_us;
    avr_cycle_count_t slice, last;
    struct pollfd input = {STDIN_FILENO, POLLIN, 0};
    avr_irq_t *in;
    avr_t *avr = avr_make_mcu_by_name("atmega328p");
    FILE *program = argc == 3 ? fopen(argv[1], "rb") : NULL;

    if (avr == NULL || program == NULL) return 2;
    size = fread(flash, 1, sizeof flash, program);
    avr_init(avr);
    avr->log = LOG_NONE;
    avr->frequency = CLOCK_HZ;
    avr_loadcode(avr, flash, (avr_flashaddr_t)size, 0);
    avr->codeend = avr->flashend;
    /* No sleep of simavr's own for a program that polls, and no lines on the console. */
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    in = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), out, NULL);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUT_XON), room, avr);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUT_XOFF), room, NULL);
    poll(&input, 1, -1);
    begun_us = now_us();
    last = (avr_cycle_count_t)atol(argv[2]) * CLOCK_HZ;
    while (avr->cycle < last) {
        slice = avr->cycle + CLOCK_HZ / 1000000 * SLICE_US;
        while (avr->cycle < slice) {
            int state = avr_run(avr);
            if (state == cpu_Done || state == cpu_Crashed) return 3;
            if (first < end && has_room) avr_raise_irq(in, waiting[first++]);
        }
        ahead_us = (int64_t)(avr->cycle / (CLOCK_HZ / 1000000)) - (now_us() - begun_us);
        if (ahead_us < -MOST_BEHIND_US) begun_us -= ahead_us;
        if (ahead_us > 0) usleep((useconds_t)ahead_us);
        if (first < end || poll(&input, 1, 0) != 1 || (input.revents & POLLIN) == 0) continue;
        first = 0;
        end = (size_t)read(STDIN_FILENO, waiting, sizeof waiting);
        if (end > sizeof waiting) return 4;
    }
    return 0;
}

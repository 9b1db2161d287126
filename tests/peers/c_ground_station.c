/*
 * A ground station around the stock MAVLink C library, as mavgen makes it from common.xml.
 *
 *     c_ground_station udp|tcp HOST PORT COMPONENT SECONDS
 *
 * Is 255/COMPONENT, because two of one address would look like one that is heard twice. Says HEARTBEAT and PARAM_REQUEST_READ once a
 * second and TIMESYNC ten times a second, so that its own frames can be counted at the other end, and stops when the last TIMESYNC is answered: all
 * before it has then been read. Prints a line for each sender that it has heard,
 * `source SYSTEM COMPONENT FRAMES GAPS`, by its sequence numbers, then
 * `library PACKET_RX_DROP_COUNT BAD_CRC SENT TIMESYNC_ANSWERS PARAM_VALUES`.
 *
 * The library's own count is that of mavlink_parse_char; a second channel with mavlink_frame_char tells a wrong checksum from nothing.
 */
#include <common/mavlink.h>

#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

enum { OWN_SYSTEM = 255, ESTIMATOR_SYSTEM = 1, ESTIMATOR_COMPONENT = 197 };
enum { STEP_MS = 100, STEPS_PER_SECOND = 10, DEADLINE_S = 20 };

struct source {
    unsigned long frames, gaps;
    uint8_t next;
};

static struct source sources[256][256];
static unsigned long dropped, bad_crc, sent, answers, values;
static int64_t last_answer;
static uint8_t own_component;
static int link_fd;

static int64_t now_ms(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

static void say(const mavlink_message_t *message)
{
    uint8_t bytes[MAVLINK_MAX_PACKET_LEN];
    uint16_t length = mavlink_msg_to_send_buffer(bytes, message);
    if (send(link_fd, bytes, length, MSG_NOSIGNAL) != length) {
        perror("send");
        exit(1);
    }
    sent++;
}

static void say_each_second(unsigned long second)
{
    static const char by_index[16] = "";
    mavlink_message_t message;
    mavlink_msg_heartbeat_pack(OWN_SYSTEM, own_component, &message, MAV_TYPE_GCS, MAV_AUTOPILOT_INVALID, 0, 0, MAV_STATE_ACTIVE);
    say(&message);
    mavlink_msg_param_request_read_pack(OWN_SYSTEM, own_component, &message, ESTIMATOR_SYSTEM, ESTIMATOR_COMPONENT, by_index, (int16_t)(second % 4));
    say(&message);
}

static void ask_time(int64_t number)
{
    mavlink_message_t message;
    mavlink_msg_timesync_pack(OWN_SYSTEM, own_component, &message, 0, number, 0, 0);
    say(&message);
}

static void take(const mavlink_message_t *message)
{
    struct source *from = &sources[message->sysid][message->compid];
    if (from->frames > 0) from->gaps += (uint8_t)(message->seq - from->next);
    from->next = (uint8_t)(message->seq + 1);
    from->frames++;
    if (message->msgid == MAVLINK_MSG_ID_PARAM_VALUE) values++;
    if (message->msgid == MAVLINK_MSG_ID_TIMESYNC && message->sysid == ESTIMATOR_SYSTEM && message->compid == ESTIMATOR_COMPONENT &&
        mavlink_msg_timesync_get_tc1(message) != 0) {
        last_answer = mavlink_msg_timesync_get_ts1(message);
        answers++;
    }
}

/* Reads what comes until that moment. */
static void hear_until(int64_t until_ms)
{
    static uint8_t bytes[65536];
    struct pollfd wanted = {link_fd, POLLIN, 0};
    mavlink_message_t message;
    mavlink_status_t status;
    int64_t left_ms;
    while ((left_ms = until_ms - now_ms()) > 0) {
        ssize_t count, i;
        if (poll(&wanted, 1, (int)left_ms) <= 0) continue;
        count = recv(link_fd, bytes, sizeof bytes, 0);
        if (count <= 0) {
            fprintf(stderr, "the station has closed the link\n");
            exit(1);
        }
        for (i = 0; i < count; i++) {
            if (mavlink_parse_char(MAVLINK_COMM_0, bytes[i], &message, &status)) take(&message);
            dropped += status.packet_rx_drop_count;
            if (mavlink_frame_char(MAVLINK_COMM_1, bytes[i], &message, &status) == MAVLINK_FRAMING_BAD_CRC) bad_crc++;
        }
    }
}

int main(int argc, char **argv)
{
    struct sockaddr_in address = {0};
    long step, steps;
    int64_t begun_ms, until_ms;
    int system, component;

    if (argc != 6) return 2;
    address.sin_family = AF_INET;
    address.sin_port = htons((uint16_t)atoi(argv[3]));
    if (inet_pton(AF_INET, argv[2], &address.sin_addr) != 1) return 2;
    link_fd = socket(AF_INET, strcmp(argv[1], "udp") == 0 ? SOCK_DGRAM : SOCK_STREAM, 0);
    if (link_fd < 0 || connect(link_fd, (struct sockaddr *)&address, sizeof address) != 0) {
        perror("connect");
        return 1;
    }
    own_component = (uint8_t)atoi(argv[4]);
    steps = atol(argv[5]) * STEPS_PER_SECOND;
    begun_ms = now_ms();
    for (step = 0; step < steps; step++) {
        if (step % STEPS_PER_SECOND == 0) say_each_second((unsigned long)(step / STEPS_PER_SECOND));
        ask_time(step + 1);
        hear_until(begun_ms + (step + 1) * STEP_MS);
    }
    ask_time(steps + 1);
    until_ms = now_ms() + DEADLINE_S * 1000;
    while (last_answer != steps + 1 && now_ms() < until_ms) hear_until(now_ms() + STEP_MS);
    for (system = 0; system < 256; system++) {
        for (component = 0; component < 256; component++) {
            const struct source *from = &sources[system][component];
            if (from->frames > 0) printf("source %d %d %lu %lu\n", system, component, from->frames, from->gaps);
        }
    }
    printf("library %lu %lu %lu %lu %lu\n", dropped, bad_crc, sent, answers, values);
    return last_answer == steps + 1 ? 0 : 3;
}

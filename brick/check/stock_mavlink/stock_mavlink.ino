// A robot that knows nothing of posebridge: the stock MAVLink C library, as mavgen makes it from common.xml, on an Arduino Uno.
//
// Says HEARTBEAT once a second, and WHEEL_DISTANCE and SCALED_IMU 20 times a second, as if it drove a circle; answers TIMESYNC.
#define MAVLINK_COMM_NUM_BUFFERS 1
// What it can hear. The whole table of common.xml takes more RAM than an Uno has: avr-gcc keeps constants there.
#define MAVLINK_MESSAGE_CRCS {{0, 50, 9, 9, 0, 0, 0}, {111, 34, 16, 16, 0, 0, 0}}
#include <common/mavlink.h>

static const uint8_t SYSTEM = 1, COMPONENT = 1;
static const uint32_t PERIOD_US = 50000;
static const uint8_t PERIODS_PER_HEARTBEAT = 20;
// The drive: a circle of 1.575 m, counter-clockwise. About their z axis, which points down, that is negative.
static const float LEFT_M_PER_S = 0.20f, RIGHT_M_PER_S = 0.22f, TRACK_M = 0.15f;
static const int16_t TURN_MRAD_PER_S = -133;

static mavlink_message_t message;

static void send()
{
    static uint8_t bytes[MAVLINK_MAX_PACKET_LEN];
    Serial.write(bytes, mavlink_msg_to_send_buffer(bytes, &message));
}

// The time since it began, which must not wrap after 71 minutes.
static uint64_t time_us()
{
    static uint32_t high, last;
    uint32_t now = micros();
    if (now < last)
        high++;
    last = now;
    return (uint64_t)high << 32 | now;
}

// A number of 64 bits as MAVLink wants it: `double` has 32 here.
static uint64_t as_double(float number)
{
    uint32_t bits;
    memcpy(&bits, &number, sizeof bits);
    if ((bits & 0x7fffffff) == 0)
        return 0;
    uint64_t sign = bits >> 31, exponent = (bits >> 23 & 0xff) + 1023 - 127, fraction = bits & 0x7fffff;
    return sign << 63 | exponent << 52 | fraction << 29;
}

// By hand, because mavlink_msg_wheel_distance_pack takes `double`s for what they are on larger computers, and sends others' memory.
static void send_wheels(uint64_t now_us)
{
    float driven_s = (float)now_us * 1e-6f;
    memset(_MAV_PAYLOAD_NON_CONST(&message), 0, MAVLINK_MSG_ID_WHEEL_DISTANCE_LEN);
    _mav_put_uint64_t(_MAV_PAYLOAD_NON_CONST(&message), 0, now_us);
    _mav_put_uint64_t(_MAV_PAYLOAD_NON_CONST(&message), 8, as_double(LEFT_M_PER_S * driven_s));
    _mav_put_uint64_t(_MAV_PAYLOAD_NON_CONST(&message), 16, as_double(RIGHT_M_PER_S * driven_s));
    _mav_put_uint8_t(_MAV_PAYLOAD_NON_CONST(&message), 136, 2);
    message.msgid = MAVLINK_MSG_ID_WHEEL_DISTANCE;
    mavlink_finalize_message(&message, SYSTEM, COMPONENT, MAVLINK_MSG_ID_WHEEL_DISTANCE_MIN_LEN, MAVLINK_MSG_ID_WHEEL_DISTANCE_LEN,
        MAVLINK_MSG_ID_WHEEL_DISTANCE_CRC);
    send();
}

static void receive(uint8_t byte)
{
    mavlink_status_t status;
    if (!mavlink_parse_char(MAVLINK_COMM_0, byte, &message, &status) || message.msgid != MAVLINK_MSG_ID_TIMESYNC)
        return;
    int64_t asked = mavlink_msg_timesync_get_ts1(&message);
    if (mavlink_msg_timesync_get_tc1(&message) != 0)
        return;
    mavlink_msg_timesync_pack(SYSTEM, COMPONENT, &message, (int64_t)time_us() * 1000, asked);
    send();
}

void setup()
{
    Serial.begin(115200);
}

void loop()
{
    static uint32_t due_us = micros();
    static uint8_t periods = 0;
    while (Serial.available() > 0)
        receive((uint8_t)Serial.read());
    if ((int32_t)(micros() - due_us) < 0)
        return;
    due_us += PERIOD_US;
    uint64_t now_us = time_us();
    if (periods == 0) {
        mavlink_msg_heartbeat_pack(SYSTEM, COMPONENT, &message, MAV_TYPE_GROUND_ROVER, MAV_AUTOPILOT_GENERIC, 0, 0, MAV_STATE_ACTIVE);
        send();
    }
    send_wheels(now_us);
    mavlink_msg_scaled_imu_pack(SYSTEM, COMPONENT, &message, (uint32_t)(now_us / 1000), 0, 0, -1000, 0, 0, TURN_MRAD_PER_S, 0, 0, 0, 0);
    send();
    periods = (uint8_t)((periods + 1) % PERIODS_PER_HEARTBEAT);
}

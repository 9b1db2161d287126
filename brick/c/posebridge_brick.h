/*
 * What a weak robot says to posebridge and hears from it: one header, C99 (and C++), no heap, no table, integers only.
 *
 * Transmit:   pb_send_heartbeat, pb_send_ticks, pb_send_inertial (pb_gyro_sample and pb_gyro_take fill it),
 *             pb_send_description, pb_send_battery
 * Receive:    pb_receive, if PB_RECEIVE is defined before this file is included: takes estimates, answers questions for the time
 *
 *     static void out(void *context, uint8_t byte) { uart_write(byte); }
 *     static pb_link link;
 *     pb_begin(&link, out, 0, 1, 1);
 *     each second:  pb_send_heartbeat(&link);
 *     50 per second:  pb_ticks ticks = {micros(), left, right, PB_BOTH}; pb_send_ticks(&link, &ticks);
 *
 * Counts and turns are totals since power-up and never increments: a lost frame then costs nothing. A time is the robot's own
 * counter of microseconds, taken when the sensor was read, not when the frame is sent; it wraps. A robot that has
 * milliseconds only multiplies by 1000. Left is counter-clockwise. Nothing here is safe against interrupts: copy a counter that an interrupt
 * changes while interrupts are off, then call.
 *
 *     MAVLink 2 frame   FD length flags 0 sequence system component id[3] payload[length] crc[2]      little-endian
 *     payload           fields, largest first; zeros at its end are not sent, one byte always is
 *     crc               CRC-16/MCRF4XX over everything behind FD, and then the message's CRC_EXTRA
 *
 * Sources: MAVLink guide, "Packet Serialization"; protocol/definitions/posebridge.xml; MAVLink's minimal.xml and common.xml.
 * brick/vectors holds the bytes that a foreign implementation makes of the same numbers.
 */
#ifndef POSEBRIDGE_BRICK_H
#define POSEBRIDGE_BRICK_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

/* Everything is a function of the file that includes this one; what it does not call costs nothing. Compilers for small machines
 * like to copy functions to where they are called, which makes the program larger: GCC and its kin are asked not to. */
#if defined(__GNUC__)
#define PB_API __attribute__((noinline, unused)) static
#else
#define PB_API static
#endif
/* A part of one other function. */
#define PB_PART static inline

/* Bits of pb_ticks.flags. The station drops a message without both. */
#define PB_LEFT 1u
#define PB_RIGHT 2u
#define PB_BOTH 3u

/* Bits of pb_inertial.valid. */
#define PB_RATE_VALID 1u
#define PB_TURN_VALID 2u
#define PB_ACCELERATIONS_VALID 4u

/* Messages are structs that lie in memory as they do on the wire; nothing is packed field by field. */
#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "posebridge_brick.h needs a little-endian machine with single precision floats of 32 bits"
#endif
/* A type that cannot be when the layout is another one. */
#define PB_LIES_AT(type, field, place) typedef char pb_##type##_##field[offsetof(type, field) == (place) ? 1 : -1]

/* Takes one byte of a frame. A sink that keeps too few of them loses the frame, and the station sees that by the sequence. */
typedef void (*pb_sink)(void *context, uint8_t byte);

/* One participant on one link. */
typedef struct {
    pb_sink sink;
    void *context;
    uint16_t crc; /* of the frame that is being sent */
    uint8_t header[10]; /* of the next frame */
} pb_link;
/* Places in a header: length, sequence, system, component, id. */
#define PB_LENGTH 1
#define PB_SEQUENCE 4
#define PB_SYSTEM 5
#define PB_COMPONENT 6
#define PB_ID 7

/* Total counts of both driven wheels since power-up: PB_WHEEL_TICKS. */
typedef struct {
    uint32_t time_us; /* when the counters were read */
    int32_t left, right; /* forward positive; wrap */
    uint8_t flags; /* PB_LEFT, PB_RIGHT: which are valid */
} pb_ticks;
PB_LIES_AT(pb_ticks, flags, 12);

/* Gyro and accelerometers: PB_INERTIAL. */
typedef struct {
    uint32_t time_us; /* end of the interval over which the rates are means */
    int32_t turn_urad; /* turn since power-up, microradians, counter-clockwise positive, bias included; wraps */
    int16_t turn_rate; /* mean, in units of 0.5 mrad/s */
    int16_t accel_left, accel_right; /* forward, at the wheels, mm/s^2 */
    uint8_t valid; /* PB_RATE_VALID, PB_TURN_VALID, PB_ACCELERATIONS_VALID */
} pb_inertial;
PB_LIES_AT(pb_inertial, valid, 14);

/* How the robot is built: PB_ROBOT_DESCRIPTION. The numbers are moved, never computed with. */
typedef struct {
    float left_wheel_radius_m, right_wheel_radius_m, track_width_m;
    float ticks_per_turn;
    float gyro_sigma_rad_per_s; /* noise of a sample; 0 without a gyro */
    float gyro_resolution_rad_per_s; /* 0 when it is fine or absent */
    char name[16]; /* UTF-8, padded with 0 */
} pb_description;
PB_LIES_AT(pb_description, name, 24);

/* Sums samples of a gyro between two messages. All zero is a gyro that has seen nothing. */
typedef struct {
    uint32_t sampled_us;
    int32_t turn_urad;
    uint32_t rest; /* what is above turn_urad, in millionths of a microradian */
    uint32_t sum; /* of rates since the last message, each above PB_LOWEST_URAD_PER_S */
    uint16_t weight; /* PB_RATE_UNIT for each of them */
    uint8_t has_begun;
} pb_gyro;

/* ---- frames --------------------------------------------------------------------------------------------------------- */

/* Start, length, two flag bytes, sequence, system, component, three bytes of id. */
#define PB_HEADER 10u
#define PB_START 0xFDu
/* Ids, and the hash of each definition that ends its checksum (computed by mavgen). */
#define PB_ID_HEARTBEAT 0u
#define PB_EXTRA_HEARTBEAT 50u
#define PB_ID_TIMESYNC 111u
#define PB_EXTRA_TIMESYNC 34u
#define PB_ID_BATTERY 147u
#define PB_EXTRA_BATTERY 154u
#define PB_ID_WHEEL_TICKS 42100u
#define PB_EXTRA_WHEEL_TICKS 170u
#define PB_ID_INERTIAL 42101u
#define PB_EXTRA_INERTIAL 94u
#define PB_ID_PLANAR_POSE 42102u
#define PB_EXTRA_PLANAR_POSE 53u
#define PB_ID_DESCRIPTION 42104u
#define PB_EXTRA_DESCRIPTION 5u

/* One step of CRC-16/MCRF4XX without a table. */
PB_API uint16_t pb_crc(uint16_t crc, uint8_t byte)
{
    byte ^= (uint8_t)crc;
    byte ^= (uint8_t)(byte << 4);
    return (uint16_t)((crc >> 8) ^ ((uint16_t)byte << 8) ^ ((uint16_t)byte << 3) ^ (byte >> 4));
}

/* From here the checksum comes to 0xFFFF, where it has to begin, by the start byte that is no part of it. */
#define PB_CRC_BEFORE_START 0x3085u

/* Sends bytes and takes them into the checksum; there is one at least. */
PB_API void pb_put(pb_link *link, const uint8_t *bytes, uint8_t count)
{
    do {
        link->crc = pb_crc(link->crc, *bytes);
        link->sink(link->context, *bytes++);
    } while (--count);
}

/* Sends a payload of length bytes, as it lies in memory, as a frame. */
PB_API void pb_send(pb_link *link, uint16_t id, uint8_t extra, const void *payload, uint8_t length)
{
    const uint8_t *bytes = (const uint8_t *)payload;
    uint16_t crc;
    while (length > 1u && bytes[length - 1u] == 0)
        length--;
    link->crc = PB_CRC_BEFORE_START;
    link->header[PB_LENGTH] = length;
    link->header[PB_ID] = (uint8_t)id;
    link->header[PB_ID + 1] = (uint8_t)(id >> 8);
    pb_put(link, link->header, PB_HEADER);
    link->header[PB_SEQUENCE]++;
    pb_put(link, bytes, length);
    crc = pb_crc(link->crc, extra);
    pb_put(link, (const uint8_t *)&crc, 2);
}

/* ---- transmit ------------------------------------------------------------------------------------------------------- */

/* A participant that has sent nothing. A robot is component 1 of a system from 1 to 254. */
PB_API void pb_begin(pb_link *link, pb_sink sink, void *context, uint8_t system, uint8_t component)
{
    memset(link, 0, sizeof *link);
    link->sink = sink;
    link->context = context;
    link->header[0] = PB_START;
    link->header[PB_SYSTEM] = system;
    link->header[PB_COMPONENT] = component;
}

/* Says that the robot is there: once per second. A ground rover (10), generic autopilot (0), active (4), MAVLink version 3. */
PB_API void pb_send_heartbeat(pb_link *link)
{
    uint8_t payload[9];
    memset(payload, 0, sizeof payload);
    payload[4] = 10;
    payload[7] = 4;
    payload[8] = 3;
    pb_send(link, PB_ID_HEARTBEAT, PB_EXTRA_HEARTBEAT, payload, sizeof payload);
}

/* Sends total counts: 10 to 50 times per second. */
PB_API void pb_send_ticks(pb_link *link, const pb_ticks *ticks)
{
    pb_send(link, PB_ID_WHEEL_TICKS, PB_EXTRA_WHEEL_TICKS, ticks, 13);
}

/* Sends gyro and accelerometers: 10 to 50 times per second. */
PB_API void pb_send_inertial(pb_link *link, const pb_inertial *inertial)
{
    pb_send(link, PB_ID_INERTIAL, PB_EXTRA_INERTIAL, inertial, 15);
}

/* Says how the robot is built: at the start, and every few seconds for stations that come later. */
PB_API void pb_send_description(pb_link *link, const pb_description *robot)
{
    pb_send(link, PB_ID_DESCRIPTION, PB_EXTRA_DESCRIPTION, robot, 40);
}

/*
 * Says how full the battery is, once a second or more rarely: millivolts of all cells together, less than 65535; percent 0 to 100, -1 if
 * unknown. BATTERY_STATUS: consumption, temperature, current and all cells but the first are unknown.
 */
PB_API void pb_send_battery(pb_link *link, uint16_t millivolts, int8_t percent)
{
    uint8_t payload[36];
    memset(payload, 0xFF, sizeof payload);
    payload[9] = 0x7F;
    memcpy(payload + 10, &millivolts, 2);
    payload[32] = 0;
    payload[33] = 1; /* of everything */
    payload[34] = 0;
    payload[35] = (uint8_t)percent;
    pb_send(link, PB_ID_BATTERY, PB_EXTRA_BATTERY, payload, sizeof payload);
}

/* ---- gyro ----------------------------------------------------------------------------------------------------------- */

/* The longest interval over which a rate is believed to hold. What is turned in a longer one is unknown and left out. */
#define PB_LONGEST_US 1000000ul
/* So much at a time, that a product stays within 32 bits. */
#define PB_PIECE_US 8000u
/* Beyond this PB_INERTIAL.turn_rate saturates, and with it the total. */
#define PB_LARGEST_URAD_PER_S 16383500l
/* Unit of PB_INERTIAL.turn_rate in microradians per second, and the lowest value that an int16_t has in it, less half a unit. */
#define PB_RATE_UNIT 500u
#define PB_LOWEST_URAD_PER_S (-32768l * 500 - 250)
/* After 100 samples the mean begins anew: so the sum stays within 32 bits. */
#define PB_MANY (100u * PB_RATE_UNIT)

/*
 * Adds rate * interval, exactly: turn_urad + rest / 1000000 stays the true sum. The product has 37 bits; it is divided by 1000000 =
 * 64 * 15625 without ever being whole, because arithmetic in 64 bits costs a small machine more memory than all the rest. To be
 * positive while it is divided, it is raised by 131072 * 15625.
 */
PB_API void pb_gyro_turn(pb_gyro *gyro, uint16_t interval_us, int32_t rate_urad_per_s)
{
    int16_t high = (int16_t)(rate_urad_per_s >> 9);
    uint16_t low = (uint16_t)rate_urad_per_s & 511u;
    uint32_t below = (uint32_t)low * interval_us + gyro->rest;
    uint32_t by_64 = (uint32_t)((int32_t)high * (int16_t)interval_us) * 8u + (below >> 6) + 2048000000ul;
    gyro->rest = by_64 % 15625u << 6 | (below & 63u);
    gyro->turn_urad = (int32_t)((uint32_t)gyro->turn_urad + by_64 / 15625u - 131072u);
}

/*
 * Takes a sample: the rate at now_us, counter-clockwise positive, microradians per second (a degree per second is 17453).
 * Each rate holds since the sample before it. Sample at nearly equal intervals, as often as can be.
 */
PB_API void pb_gyro_sample(pb_gyro *gyro, uint32_t now_us, int32_t rate_urad_per_s)
{
    uint32_t interval_us = now_us - gyro->sampled_us;
    gyro->sampled_us = now_us;
    if (rate_urad_per_s > PB_LARGEST_URAD_PER_S)
        rate_urad_per_s = PB_LARGEST_URAD_PER_S;
    if (rate_urad_per_s < -PB_LARGEST_URAD_PER_S)
        rate_urad_per_s = -PB_LARGEST_URAD_PER_S;
    if (!gyro->has_begun || interval_us > PB_LONGEST_US)
        interval_us = 0;
    gyro->has_begun = 1;
    while (interval_us) {
        uint16_t piece_us = interval_us < PB_PIECE_US ? (uint16_t)interval_us : PB_PIECE_US;
        pb_gyro_turn(gyro, piece_us, rate_urad_per_s);
        interval_us -= piece_us;
    }
    if (gyro->weight == PB_MANY) {
        gyro->sum = 0;
        gyro->weight = 0;
    }
    gyro->sum += (uint32_t)(rate_urad_per_s - (int32_t)PB_LOWEST_URAD_PER_S);
    gyro->weight += PB_RATE_UNIT;
}

/* Fills what is to be sent: total turn, and mean rate since the last call. 0 and nothing filled if there was no sample since. */
PB_API uint8_t pb_gyro_take(pb_gyro *gyro, pb_inertial *inertial)
{
    if (gyro->weight == 0)
        return 0;
    inertial->time_us = gyro->sampled_us;
    inertial->turn_urad = gyro->turn_urad;
    inertial->turn_rate = (int16_t)(uint16_t)(gyro->sum / gyro->weight - 32768u);
    inertial->accel_left = inertial->accel_right = 0;
    inertial->valid = PB_RATE_VALID | PB_TURN_VALID;
    gyro->sum = 0;
    gyro->weight = 0;
    return 1;
}

/* ---- receive -------------------------------------------------------------------------------------------------------- */

#ifdef PB_RECEIVE

/* Bits of pb_pose.flags. */
#define PB_POSITION_VALID 1u
#define PB_HEADING_VALID 2u
#define PB_SPEEDS_VALID 4u
#define PB_DEAD_RECKONING 8u
#define PB_PREDICTED 16u

#define PB_LENGTH_PLANAR_POSE 56u
#define PB_LENGTH_TIMESYNC 18u
#define PB_WINDOW (PB_HEADER + PB_LENGTH_PLANAR_POSE + 2u)

/* The station's estimate in the arena: PB_PLANAR_POSE. All numbers are finite. */
typedef struct {
    uint32_t time_us; /* the instant for which it holds, on the robot's own clock */
    float x_m, y_m; /* east, north */
    float heading_rad; /* counter-clockwise from east */
    float forward_speed_m_per_s, turn_rate_rad_per_s;
    float covariance[6]; /* of x, y, heading: upper triangle row by row, m^2, m rad, rad^2 */
    uint16_t fix_age_ms; /* 65534 for that long or longer, 65535 before the first fix */
    uint8_t reset_counter; /* counts jumps that are not motion */
    uint8_t flags;
    uint32_t epoch; /* rises with every owner of the robot in a fleet of stations; drop a lower one than you have seen */
} pb_pose;
PB_LIES_AT(pb_pose, epoch, PB_LENGTH_PLANAR_POSE - 4u);

/* A window on the bytes of a link. All zero is one that has heard nothing. */
typedef struct {
    uint8_t bytes[PB_WINDOW];
    uint8_t count;
} pb_receiver;

/* Whether size bytes of little-endian single precision numbers are all finite: not all bits of the exponent are set. */
PB_PART uint8_t pb_are_finite(const uint8_t *place, uint8_t size)
{
    for (; size; size = (uint8_t)(size - 4u), place += 4)
        if ((place[3] & 0x7Fu) == 0x7Fu && (place[2] & 0x80u))
            return 0;
    return 1;
}

/* Answers what time it is, if the question is one and for us; header and whole payload of what came. */
PB_PART void pb_answer_time(pb_link *link, const uint8_t *header, uint8_t *payload, uint32_t now_us)
{
    uint8_t index;
    uint32_t carry = 0;
    for (index = 0; index < 8u; index++)
        if (payload[index] != 0)
            return;
    if ((payload[16] && payload[16] != link->header[PB_SYSTEM]) || (payload[17] && payload[17] != link->header[PB_COMPONENT]))
        return;
    /* Nanoseconds: now_us * 1000, byte by byte. An answer of 0 would be a question. */
    payload[0] = now_us == 0;
    for (index = 0; now_us || carry; index++) {
        carry += (now_us & 0xFFu) * 1000u;
        now_us >>= 8;
        payload[index] = (uint8_t)carry;
        carry >>= 8;
    }
    payload[16] = header[PB_SYSTEM];
    payload[17] = header[PB_COMPONENT];
    pb_send(link, PB_ID_TIMESYNC, PB_EXTRA_TIMESYNC, payload, PB_LENGTH_TIMESYNC);
}

/*
 * What the window begins with: the length of a whole frame whose checksum fits, 0 if it is none and the first byte may go,
 * PB_OPEN if more bytes are needed. Header: length 1 to 56, no flag but that of a signature, a known id.
 */
#define PB_OPEN 255u
PB_PART uint8_t pb_judge(const pb_receiver *receiver)
{
    const uint8_t *bytes = receiver->bytes;
    uint8_t length = bytes[PB_LENGTH], extra = PB_EXTRA_TIMESYNC, most = PB_LENGTH_TIMESYNC, second = 0, index;
    uint16_t crc = 0xFFFFu;
    if (bytes[0] != PB_START)
        return 0;
    if (receiver->count < PB_HEADER)
        return PB_OPEN;
    if (bytes[PB_ID] == (PB_ID_PLANAR_POSE & 0xFFu)) {
        extra = PB_EXTRA_PLANAR_POSE;
        most = PB_LENGTH_PLANAR_POSE;
        second = PB_ID_PLANAR_POSE >> 8;
    } else if (bytes[PB_ID] != PB_ID_TIMESYNC) {
        return 0;
    }
    if (length == 0 || length > most || bytes[2] > 1u || bytes[PB_ID + 1] != second || bytes[PB_ID + 2] != 0)
        return 0;
    length = (uint8_t)(length + PB_HEADER + 2u);
    if (receiver->count < length)
        return PB_OPEN;
    for (index = 1; index < length - 2u; index++)
        crc = pb_crc(crc, bytes[index]);
    crc = pb_crc(crc, extra);
    return bytes[length - 2u] == (uint8_t)crc && bytes[length - 1u] == (uint8_t)(crc >> 8) ? length : 0;
}

/* Acts upon the whole frame of length bytes that the window begins with. 1 if it was an estimate. */
PB_PART uint8_t pb_take(pb_link *link, const pb_receiver *receiver, uint8_t length, uint32_t now_us, pb_pose *pose)
{
    uint8_t payload[PB_LENGTH_PLANAR_POSE];
    memset(payload, 0, sizeof payload);
    memcpy(payload, receiver->bytes + PB_HEADER, length - PB_HEADER - 2u);
    if (receiver->bytes[PB_ID] == PB_ID_TIMESYNC) {
        pb_answer_time(link, receiver->bytes, payload, now_us);
        return 0;
    }
    if (!pb_are_finite(payload + 4, 44))
        return 0;
    memcpy(pose, payload, sizeof payload);
    return 1;
}

/*
 * Takes the next byte. Answers a question for the time on the spot, by now_us: the clock that the sensors are stamped with.
 * Returns 1 when an estimate came; it stands in pose. A damaged or torn frame is dropped alone: what began inside it is found.
 */
PB_API uint8_t pb_receive(pb_link *link, pb_receiver *receiver, uint8_t byte, uint32_t now_us, pb_pose *pose)
{
    uint8_t has_pose = 0, length;
    receiver->bytes[receiver->count++] = byte;
    while (receiver->count && (length = pb_judge(receiver)) != PB_OPEN) {
        if (length)
            has_pose |= pb_take(link, receiver, length, now_us, pose);
        else
            length = 1;
        receiver->count = (uint8_t)(receiver->count - length);
        memmove(receiver->bytes, receiver->bytes + length, receiver->count);
    }
    return has_pose;
}

/* Thousandths of a finite number, towards zero, without any floating point: metres to millimetres. Saturates. */
PB_API int32_t pb_milli(float value)
{
    uint32_t bits, mantissa;
    int16_t shift;
    memcpy(&bits, &value, sizeof bits);
    /* value = mantissa * 2^-shift; times 1000 = 125 * 2^3, so that the product of 24 and 7 bits stays within 32. */
    shift = (int16_t)(150 - 3 - (int16_t)(bits >> 23 & 0xFFu));
    mantissa = ((bits & 0x7FFFFFul) | 0x800000ul) * 125u;
    if (shift < 0)
        mantissa = 0x7FFFFFFFul;
    else
        mantissa = shift > 31 ? 0 : mantissa >> shift;
    if (mantissa > 0x7FFFFFFFul)
        mantissa = 0x7FFFFFFFul;
    return bits >> 31 ? -(int32_t)mantissa : (int32_t)mantissa;
}

#endif /* PB_RECEIVE */

#endif /* POSEBRIDGE_BRICK_H */

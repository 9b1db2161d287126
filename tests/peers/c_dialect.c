/* Our messages through the stock C library with our header: frames on standard input, what they hold on standard output.
 *
 * A line for each message: its id; of ours also the fields in the order of the wire, and the frame as the library writes it again.
 */
#include <stdio.h>

#include "posebridge_mavlink.h"

static void print_floats(const float *values, int count)
{
    for (int index = 0; index < count; index++) {
        printf(" %.17g", (double)values[index]);
    }
}

static void print_ticks(const mavlink_message_t *read, mavlink_message_t *written)
{
    mavlink_pb_wheel_ticks_t ticks;
    mavlink_msg_pb_wheel_ticks_decode(read, &ticks);
    printf(" %u %d %d %u", ticks.time_us, ticks.left, ticks.right, ticks.flags);
    mavlink_msg_pb_wheel_ticks_encode(read->sysid, read->compid, written, &ticks);
}

static void print_inertial(const mavlink_message_t *read, mavlink_message_t *written)
{
    mavlink_pb_inertial_t inertial;
    mavlink_msg_pb_inertial_decode(read, &inertial);
    printf(" %u %d %d %d %d %u", inertial.time_us, inertial.turn_urad, inertial.turn_rate, inertial.accel_left, inertial.accel_right,
        inertial.valid);
    mavlink_msg_pb_inertial_encode(read->sysid, read->compid, written, &inertial);
}

static void print_pose(const mavlink_message_t *read, mavlink_message_t *written)
{
    mavlink_pb_planar_pose_t pose;
    mavlink_msg_pb_planar_pose_decode(read, &pose);
    printf(" %u", pose.time_us);
    print_floats((const float[]){pose.x, pose.y, pose.heading, pose.forward_speed, pose.turn_rate}, 5);
    print_floats(pose.covariance, 6);
    printf(" %u %u %u %u", pose.fix_age_ms, pose.reset_counter, pose.flags, pose.epoch);
    mavlink_msg_pb_planar_pose_encode(read->sysid, read->compid, written, &pose);
}

static void print_health(const mavlink_message_t *read, mavlink_message_t *written)
{
    mavlink_pb_fusion_health_t health;
    mavlink_msg_pb_fusion_health_decode(read, &health);
    printf(" %u", health.time_us);
    print_floats(health.innovation, 3);
    print_floats(&health.nis_per_dof, 1);
    printf(" %u %u %u %u %u", health.lag_ms, health.accepted, health.refused, health.sensor, health.verdict);
    mavlink_msg_pb_fusion_health_encode(read->sysid, read->compid, written, &health);
}

static void print_robot(const mavlink_message_t *read, mavlink_message_t *written)
{
    mavlink_pb_robot_description_t robot;
    mavlink_msg_pb_robot_description_decode(read, &robot);
    print_floats((const float[]){robot.left_wheel_radius, robot.right_wheel_radius, robot.track_width, robot.ticks_per_turn, robot.gyro_sigma,
        robot.gyro_resolution}, 6);
    printf(" %.16s", robot.name);
    mavlink_msg_pb_robot_description_encode_chan(read->sysid, read->compid, MAVLINK_COMM_1, written, &robot);
}

int main(void)
{
    mavlink_message_t message = {0}, written = {0};
    mavlink_status_t status;
    int byte, dropped = 0;
    while ((byte = getchar()) != EOF) {
        const uint8_t result = mavlink_frame_char(MAVLINK_COMM_0, (uint8_t)byte, &message, &status);
        dropped += result == MAVLINK_FRAMING_BAD_CRC;
        if (result != MAVLINK_FRAMING_OK) {
            continue;
        }
        printf("%u", message.msgid);
        /* Both functions that write count here. */
        mavlink_get_channel_status(MAVLINK_COMM_0)->current_tx_seq = message.seq;
        mavlink_get_channel_status(MAVLINK_COMM_1)->current_tx_seq = message.seq;
        switch (message.msgid) {
        case MAVLINK_MSG_ID_PB_WHEEL_TICKS: print_ticks(&message, &written); break;
        case MAVLINK_MSG_ID_PB_INERTIAL: print_inertial(&message, &written); break;
        case MAVLINK_MSG_ID_PB_PLANAR_POSE: print_pose(&message, &written); break;
        case MAVLINK_MSG_ID_PB_FUSION_HEALTH: print_health(&message, &written); break;
        case MAVLINK_MSG_ID_PB_ROBOT_DESCRIPTION: print_robot(&message, &written); break;
        default: printf("\n"); continue;
        }
        uint8_t frame[MAVLINK_MAX_PACKET_LEN];
        const uint16_t length = mavlink_msg_to_send_buffer(frame, &written);
        printf(" ");
        for (uint16_t index = 0; index < length; index++) {
            printf("%02x", frame[index]);
        }
        printf("\n");
    }
    printf("dropped %d\n", dropped);
    return 0;
}

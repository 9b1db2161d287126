"""Writes golden.json: frames made by pymavlink, a foreign implementation, to test our codec against.

Usage: make_golden.py posebridge.xml common.xml ardupilotmega.xml > golden.json     (see README.md for the whole recipe)
"""

import importlib.util
import json
import math
import os
import struct
import sys
import tempfile

os.environ["MAVLINK20"] = "1"

from pymavlink.generator import mavgen  # noqa: E402

NAN = float("nan")


def load(xml, protocol):
    """Generates the Python module of a dialect and imports it."""
    name = os.path.splitext(os.path.basename(xml))[0] + "_" + protocol.replace(".", "")
    path = os.path.join(tempfile.mkdtemp(), name)
    options = mavgen.Opts(path, wire_protocol=protocol, language="Python3", validate=False)
    with open(os.devnull, "w") as quiet:
        stdout, sys.stdout = sys.stdout, quiet
        mavgen.mavgen(options, [xml])
        sys.stdout = stdout
    spec = importlib.util.spec_from_file_location(name, path + ".py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def frame(module, message, system, component, sequence, signed=False, **fields):
    """Encodes one message as a whole frame."""
    link = module.MAVLink(None, srcSystem=system, srcComponent=component)
    link.seq = sequence
    if signed:
        link.signing.secret_key = bytes(range(32))
        link.signing.sign_outgoing = True
        link.signing.link_id = 3
        link.signing.timestamp = 123456789
    encode = getattr(link, message + "_encode")
    if message == "heartbeat":
        fields["mavlink_version"] = 3
    return encode(**fields).pack(link).hex()


def upper(xx, xy, xh, yy, yh, hh, rest=1e4):
    """Planar covariance in the 6 x 6 upper triangle, given in the frame of the message."""
    full = [0.0] * 21
    full[0], full[1], full[5], full[6], full[10], full[20] = xx, xy, xh, yy, yh, hh
    full[11] = full[15] = full[18] = rest
    return full


UNKNOWN = [NAN] + [0.0] * 20

HEARTBEAT = dict(type=10, autopilot=0, base_mode=0, custom_mode=0, system_status=4)
ATTITUDE = dict(time_boot_ms=123456, roll=0.0, pitch=0.0, yaw=0.5, rollspeed=0.0, pitchspeed=0.0, yawspeed=-0.25)


def own_cases(own):
    yield "pb_wheel_ticks", frame(own, "pb_wheel_ticks", 1, 1, 7, time_us=4294967290, left=-123456, right=2147483647, flags=3)
    yield "pb_inertial", frame(
        own, "pb_inertial", 1, 1, 8,
        time_us=50000, turn_urad=-1500000, turn_rate=-3000, accel_left=250, accel_right=-32768, valid=7)
    yield "pb_inertial_gyro_only", frame(
        own, "pb_inertial", 1, 1, 9,
        time_us=50000, turn_urad=0, turn_rate=1, accel_left=0, accel_right=0, valid=1)
    yield "pb_planar_pose", frame(
        own, "pb_planar_pose", 1, 197, 255,
        time_us=1000001, x=1.5, y=-2.25, heading=3.0, forward_speed=0.125, turn_rate=-0.5,
        covariance=[0.01, 0.002, -0.003, 0.04, 0.005, 0.06], fix_age_ms=250, reset_counter=2, flags=0b10111)
    yield "pb_planar_pose_no_fix", frame(
        own, "pb_planar_pose", 1, 197, 0,
        time_us=0, x=0.0, y=0.0, heading=0.0, forward_speed=0.0, turn_rate=0.0,
        covariance=[0.0] * 6, fix_age_ms=65535, reset_counter=0, flags=0)
    yield "pb_planar_pose_in_a_fleet", frame(
        own, "pb_planar_pose", 1, 197, 1,
        time_us=1000001, x=1.5, y=-2.25, heading=3.0, forward_speed=0.125, turn_rate=-0.5,
        covariance=[0.01, 0.002, -0.003, 0.04, 0.005, 0.06], fix_age_ms=250, reset_counter=2, flags=0b10111, epoch=770)
    yield "pb_fusion_health", frame(
        own, "pb_fusion_health", 1, 197, 1,
        time_us=777, innovation=[0.5, -0.25, 0.125], nis_per_dof=3.5, lag_ms=120, accepted=65535, refused=3,
        sensor=3, verdict=1)
    yield "pb_robot_description", frame(
        own, "pb_robot_description", 1, 1, 2,
        left_wheel_radius=0.028, right_wheel_radius=0.0281, track_width=0.112, ticks_per_turn=360.0,
        gyro_sigma=0.0125, gyro_resolution=0.0174532925, name=b"brick-7")


def conversation_cases(std):
    yield "heartbeat", frame(std, "heartbeat", 1, 1, 0, **HEARTBEAT)
    yield "heartbeat_of_unlisted_type", frame(
        std, "heartbeat", 9, 250, 77, type=201, autopilot=99, base_mode=255, custom_mode=4, system_status=200)
    yield "heartbeat_signed", frame(std, "heartbeat", 1, 1, 5, signed=True, **HEARTBEAT)
    yield "system_time", frame(std, "system_time", 1, 1, 3, time_unix_usec=1700000000123456, time_boot_ms=98765)
    yield "timesync_request", frame(std, "timesync", 1, 197, 4, tc1=0, ts1=123456789012, target_system=0, target_component=0)
    yield "timesync_answer", frame(std, "timesync", 1, 1, 5, tc1=-5, ts1=123456789012, target_system=1, target_component=197)
    yield "set_message_interval", frame(
        std, "command_long", 1, 197, 6, target_system=1, target_component=1, command=511, confirmation=0,
        param1=42100.0, param2=20000.0, param3=0, param4=0, param5=0, param6=0, param7=0)
    yield "stop_message", frame(
        std, "command_long", 1, 197, 7, target_system=1, target_component=1, command=511, confirmation=0,
        param1=26.0, param2=-1.0, param3=0, param4=0, param5=0, param6=0, param7=0)
    yield "command_of_unlisted_number", frame(
        std, "command_long", 255, 190, 8, target_system=1, target_component=197, command=65000, confirmation=0,
        param1=1.0, param2=2.0, param3=3.0, param4=-4.0, param5=5.0, param6=6.0, param7=7.5)
    yield "command_ack", frame(
        std, "command_ack", 1, 1, 9, command=511, result=0, progress=0, result_param2=0,
        target_system=1, target_component=197)
    yield "command_ack_of_unlisted_number", frame(
        std, "command_ack", 1, 197, 9, command=65000, result=3, progress=0, result_param2=0,
        target_system=255, target_component=190)
    yield "statustext", frame(std, "statustext", 1, 1, 10, severity=4, text=b"battery is low", id=0, chunk_seq=0)
    yield "param_request_list", frame(std, "param_request_list", 255, 190, 11, target_system=1, target_component=0)
    yield "param_request_read", frame(
        std, "param_request_read", 255, 190, 12, target_system=1, target_component=197, param_id=b"GATE_SIGMA", param_index=-1)
    yield "param_set", frame(
        std, "param_set", 255, 190, 13, target_system=1, target_component=197, param_id=b"SIXTEEN_BYTES_OK",
        param_value=2.5, param_type=9)
    yield "param_value", frame(
        std, "param_value", 1, 197, 14, param_id=b"GATE_SIGMA", param_value=3.0, param_type=9, param_count=40, param_index=17)


def request_cases(std):
    """What a ground station asks: integers bytewise in the slot of a parameter, and the commands that are served."""
    def whole(pattern, value):
        return struct.unpack("<f", struct.pack(pattern, value).ljust(4, b"\0"))[0]

    for kind, pattern, value in [(1, "<B", 200), (2, "<b", -3), (3, "<H", 40000), (4, "<h", -300), (5, "<I", 70000), (6, "<i", -5)]:
        yield f"param_set_of_type_{kind}", frame(
            std, "param_set", 255, 190, 15, target_system=1, target_component=197, param_id=b"reset_after_n",
            param_value=whole(pattern, value), param_type=kind)
    yield "param_set_of_type_10", frame(
        std, "param_set", 255, 190, 15, target_system=1, target_component=197, param_id=b"reset_after_n", param_value=1.0, param_type=10)
    for command, params in [
        ("MAV_CMD_PREFLIGHT_STORAGE", [1.0]),
        ("MAV_CMD_LOGGING_START", []),
        ("MAV_CMD_LOGGING_STOP", []),
        ("MAV_CMD_USER_1", [3.0, 2.0, 90.0, 0.25, 45.0]),
        ("MAV_CMD_USER_2", []),
        ("MAV_CMD_USER_3", [2.0]),
        ("MAV_CMD_USER_4", [3.0, 1.0]),
    ]:
        params = dict(zip((f"param{n}" for n in range(1, 8)), params + [0.0] * 7))
        yield command.lower(), frame(
            std, "command_long", 255, 190, 16, target_system=1, target_component=197, command=getattr(std, command), confirmation=0,
            **params)


def sensor_cases(std):
    distance = [0.0] * 16
    distance[0], distance[1] = 12.345678901, -0.5
    yield "wheel_distance", frame(std, "wheel_distance", 1, 1, 15, time_usec=5000000, count=2, distance=distance)
    yield "scaled_imu", frame(
        std, "scaled_imu", 1, 1, 16, time_boot_ms=4000, xacc=100, yacc=0, zacc=0, xgyro=0, ygyro=0, zgyro=-750,
        xmag=0, ymag=0, zmag=0, temperature=0)
    imu = dict(
        xacc=1.25, yacc=0.0, zacc=0.0, xgyro=0.0, ygyro=0.0, zgyro=-0.75, xmag=0.0, ymag=0.0, zmag=0.0,
        abs_pressure=0.0, diff_pressure=0.0, pressure_alt=0.0, temperature=0.0, id=0)
    yield "highres_imu", frame(std, "highres_imu", 1, 1, 17, time_usec=6000000, fields_updated=33, **imu)
    yield "highres_imu_of_the_second_unit", frame(
        std, "highres_imu", 1, 1, 88, time_usec=6000000, fields_updated=33, **dict(imu, id=1))
    imu["xacc"] = 0.0
    yield "highres_imu_gyro_only", frame(std, "highres_imu", 1, 1, 18, time_usec=6000000, fields_updated=32, **imu)
    ranger = dict(
        time_boot_ms=7000, min_distance=0, max_distance=65535, current_distance=123, type=4, id=0, orientation=0,
        horizontal_fov=0.0, vertical_fov=0.0, quaternion=[0.0] * 4, signal_quality=0)
    yield "distance_sensor", frame(std, "distance_sensor", 1, 1, 19, covariance=4, **ranger)
    yield "distance_sensor_sigma_unknown", frame(std, "distance_sensor", 1, 1, 20, covariance=255, **ranger)
    yield "distance_sensor_sideways", frame(
        std, "distance_sensor", 1, 1, 21, covariance=4, **dict(ranger, orientation=2))
    yield "distance_sensor_bad_quality", frame(
        std, "distance_sensor", 1, 1, 22, covariance=4, **dict(ranger, signal_quality=1))


def vehicle_cases(std, ardupilot):
    """What autopilots send of their sensors."""
    raw = dict(xacc=-999, yacc=0, zacc=0, xgyro=0, ygyro=0, zgyro=-750, xmag=0, ymag=0, zmag=0, temperature=0)
    yield "raw_imu", frame(std, "raw_imu", 1, 1, 52, time_usec=404409989, id=0, **raw)
    yield "raw_imu_of_the_second_unit", frame(std, "raw_imu", 1, 1, 86, time_usec=404409989, id=1, **raw)
    yield "scaled_imu2", frame(std, "scaled_imu2", 1, 1, 53, time_boot_ms=404428, **raw)
    yield "scaled_imu3", frame(std, "scaled_imu3", 1, 1, 54, time_boot_ms=404429, **raw)
    yield "rpm", frame(ardupilot, "rpm", 1, 1, 55, rpm1=120.0, rpm2=-60.0)
    yield "rpm_without_the_second_sensor", frame(ardupilot, "rpm", 1, 1, 87, rpm1=120.0, rpm2=-1.0)
    yield "rpm_not_a_number", frame(ardupilot, "rpm", 1, 1, 56, rpm1=NAN, rpm2=0.0)
    place = dict(
        time_usec=300324000, lat=411847694, lon=-960099007, alt=0, epv=65535, vel=357, cog=65535, satellites_visible=255,
        alt_ellipsoid=0, v_acc=0, vel_acc=0, hdg_acc=0)
    yield "gps_raw_int", frame(std, "gps_raw_int", 1, 1, 57, fix_type=3, eph=65535, h_acc=1250, **place)
    yield "gps_raw_int_dilution", frame(std, "gps_raw_int", 1, 1, 58, fix_type=3, eph=186, h_acc=0, **dict(place, vel=65535))
    yield "gps_raw_int_of_unknown_accuracy", frame(std, "gps_raw_int", 1, 1, 59, fix_type=2, eph=65535, h_acc=0, **place)
    yield "gps_raw_int_without_fix", frame(std, "gps_raw_int", 1, 1, 60, fix_type=1, eph=186, h_acc=0, **place)
    yield "gps_raw_int_static", frame(std, "gps_raw_int", 1, 1, 61, fix_type=7, eph=186, h_acc=0, **place)
    yield "gps_raw_int_off_the_earth", frame(
        std, "gps_raw_int", 1, 1, 62, fix_type=3, eph=186, h_acc=0, **dict(place, lat=910000000))
    target = dict(
        time_usec=12000000, target_num=7, angle_x=0.0, angle_y=0.0, distance=5.0, size_x=0.0, size_y=0.0, z=0.0,
        q=[1.0, 0.0, 0.0, 0.0], type=3)
    yield "landing_target", frame(
        std, "landing_target", 1, 1, 63, frame=12, x=3.0, y=-4.0, position_valid=1, **target)
    yield "landing_target_by_angles", frame(
        std, "landing_target", 1, 1, 64, frame=12, x=0.0, y=0.0, position_valid=0, **target)
    yield "landing_target_north_east_down", frame(
        std, "landing_target", 1, 1, 65, frame=1, x=3.0, y=-4.0, position_valid=1, **target)
    yield "global_vision_not_a_number", frame(
        std, "global_vision_position_estimate", 1, 100, 91, usec=8000000, x=NAN, y=1.0, z=0.0, roll=0.0, pitch=0.0, yaw=0.0,
        covariance=UNKNOWN, reset_counter=0)
    yield "global_vision", frame(
        std, "global_vision_position_estimate", 1, 100, 66, usec=8000000, x=2.0, y=1.0, z=0.0, roll=0.0, pitch=0.0,
        yaw=math.radians(30.0), covariance=upper(0.04, 0.005, 0.0, 0.01, 0.0, 0.002), reset_counter=3)


def display_cases(std):
    """What ground stations show of a vehicle, and how they steer it."""
    place = dict(latitude=520115000, longitude=-43571000, altitude=12500)
    half_turn = math.radians(30.0) / 2
    yield "global_position_int", frame(
        std, "global_position_int", 1, 1, 67, time_boot_ms=123456, lat=520115000, lon=-43571000, alt=12500, relative_alt=0,
        vx=50, vy=-25, vz=0, hdg=3000)
    yield "global_position_int_without_heading", frame(
        std, "global_position_int", 1, 1, 68, time_boot_ms=123456, lat=520115000, lon=-43571000, alt=12500, relative_alt=0,
        vx=50, vy=-25, vz=0, hdg=65535)
    yield "home_position", frame(
        std, "home_position", 1, 1, 69, x=0.0, y=0.0, z=0.0, q=[1.0, 0.0, 0.0, 0.0], approach_x=0.0, approach_y=0.0,
        approach_z=0.0, time_usec=5000000, **place)
    yield "gps_global_origin", frame(std, "gps_global_origin", 1, 1, 70, time_usec=5000000, **place)
    yield "set_gps_global_origin", frame(std, "set_gps_global_origin", 255, 190, 71, target_system=1, time_usec=0, **place)
    yield "vfr_hud", frame(
        std, "vfr_hud", 1, 1, 72, airspeed=0.5, groundspeed=0.5, heading=30, throttle=0, alt=12.5, climb=0.0)
    yield "attitude_quaternion", frame(
        std, "attitude_quaternion", 1, 1, 73, time_boot_ms=123456, q1=math.cos(half_turn), q2=0.0, q3=0.0, q4=math.sin(half_turn),
        rollspeed=0.0, pitchspeed=0.0, yawspeed=-0.25)
    errors = dict(drop_rate_comm=0, errors_comm=0, errors_count1=0, errors_count2=0, errors_count3=0, errors_count4=0)
    sensors = dict(onboard_control_sensors_present=0x2041, onboard_control_sensors_enabled=0x2041, onboard_control_sensors_health=0x2001)
    yield "sys_status", frame(
        std, "sys_status", 1, 1, 74, load=0, voltage_battery=7910, current_battery=125, battery_remaining=80, **sensors, **errors)
    yield "sys_status_of_unknown_battery", frame(
        std, "sys_status", 1, 1, 75, load=0, voltage_battery=65535, current_battery=-1, battery_remaining=-1, **sensors, **errors)
    pack = dict(id=0, battery_function=1, type=0, temperature=32767, current_consumed=-1, energy_consumed=-1)
    yield "battery_status", frame(
        std, "battery_status", 1, 1, 76, voltages=[7910] + [65535] * 9, current_battery=-1, battery_remaining=80, **pack)
    yield "battery_status_of_cells", frame(
        std, "battery_status", 1, 1, 77, voltages=[4100, 4050] + [65535] * 8, current_battery=125, battery_remaining=-1, **pack)
    yield "battery_status_of_the_second_battery", frame(
        std, "battery_status", 1, 1, 89, voltages=[7910] + [65535] * 9, current_battery=-1, battery_remaining=80, **dict(pack, id=1))
    yield "battery_status_of_twelve_cells", frame(
        std, "battery_status", 1, 1, 90, voltages=[4000] * 10, current_battery=-1, battery_remaining=80, voltages_ext=[4000, 3000, 0, 0],
        **pack)
    yield "extended_sys_state", frame(std, "extended_sys_state", 1, 1, 78, vtol_state=0, landed_state=1)
    yield "extended_sys_state_in_air", frame(std, "extended_sys_state", 1, 1, 79, vtol_state=0, landed_state=2)
    yield "manual_control", frame(std, "manual_control", 255, 190, 80, target=1, x=500, y=32767, z=32767, r=-250, buttons=0)
    yield "manual_control_without_turn", frame(
        std, "manual_control", 255, 190, 81, target=1, x=-1000, y=0, z=500, r=32767, buttons=3)
    still = dict(z=0.0, vy=0.0, vz=0.0, afx=0.0, afy=0.0, afz=0.0, yaw=0.0)
    target = dict(time_boot_ms=0, target_system=1, target_component=1)
    yield "position_target", frame(
        std, "set_position_target_local_ned", 255, 190, 82, coordinate_frame=1, type_mask=0b111111111100, x=2.0, y=1.0, vx=0.0,
        yaw_rate=0.0, **target, **still)
    yield "velocity_target", frame(
        std, "set_position_target_local_ned", 255, 190, 83, coordinate_frame=12, type_mask=0b011111110111, x=0.0, y=0.0, vx=0.25,
        yaw_rate=-0.5, **target, **still)
    yield "velocity_target_north_east_down", frame(
        std, "set_position_target_local_ned", 255, 190, 84, coordinate_frame=1, type_mask=0b011111110111, x=0.0, y=0.0, vx=0.25,
        yaw_rate=-0.5, **target, **still)
    yield "velocity_target_not_a_number", frame(
        std, "set_position_target_local_ned", 255, 190, 85, coordinate_frame=12, type_mask=0b011111110111, x=0.0, y=0.0, vx=NAN,
        yaw_rate=-0.5, **target, **still)


def thermometer_cases(std):
    pressure = dict(time_boot_ms=123456, press_abs=1013.25, press_diff=-0.5, temperature_press_diff=0)
    yield "scaled_pressure", frame(std, "scaled_pressure", 1, 1, 34, temperature=-1234, **pressure)
    yield "scaled_pressure_without_pressures", frame(
        std, "scaled_pressure", 1, 1, 35, temperature=4871, **dict(pressure, press_abs=0.0, press_diff=0.0))
    yield "scaled_pressure_below_absolute_zero", frame(std, "scaled_pressure", 1, 1, 36, temperature=-32768, **pressure)
    named = dict(time_boot_ms=4294967295)
    yield "named_temperature", frame(std, "named_value_float", 1, 1, 37, name=b"temp1", value=36.25, **named)
    yield "named_temperature_without_terminator", frame(
        std, "named_value_float", 7, 158, 38, name=b"temp_water", value=-40.5, **named)
    yield "named_temperature_not_a_number", frame(std, "named_value_float", 1, 1, 39, name=b"temp", value=NAN, **named)
    yield "named_temperature_infinite", frame(
        std, "named_value_float", 1, 1, 40, name=b"temp", value=float("inf"), **named)
    yield "named_temperature_too_hot", frame(std, "named_value_float", 1, 1, 41, name=b"temp", value=1e9, **named)
    yield "named_value_of_another_kind", frame(std, "named_value_float", 1, 1, 42, name=b"voltage", value=7.5, **named)


def pose_cases(std):
    # North 2, east 1; looking 30 degrees east of north.
    yaw = math.radians(30.0)
    vision = dict(usec=8000000, x=2.0, y=1.0, z=0.0, roll=0.0, pitch=0.0, reset_counter=3)
    known = upper(0.04, 0.005, 0.0, 0.01, 0.0, 0.002)
    yield "vision", frame(std, "vision_position_estimate", 1, 100, 23, yaw=yaw, covariance=known, **vision)
    yield "vision_without_heading", frame(
        std, "vision_position_estimate", 1, 100, 24, yaw=NAN, covariance=UNKNOWN, **vision)
    quaternion = [math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)]
    yield "mocap", frame(
        std, "att_pos_mocap", 1, 100, 25, time_usec=8000000, q=quaternion, x=2.0, y=1.0, z=0.0, covariance=known)
    odometry = dict(
        time_usec=9000000, x=2.0, y=1.0, z=0.0, q=quaternion, vx=0.5, vy=0.0, vz=0.0,
        rollspeed=0.0, pitchspeed=0.0, yawspeed=-0.25, velocity_covariance=UNKNOWN, reset_counter=1,
        estimator_type=0, quality=90)
    moving = upper(0.04, 0.005, 0.001, 0.01, -0.002, 0.003)
    yield "odometry_arena", frame(
        std, "odometry", 1, 197, 26, frame_id=1, child_frame_id=12, pose_covariance=moving, **odometry)
    yield "odometry_odom", frame(
        std, "odometry", 1, 1, 27, frame_id=20, child_frame_id=12, pose_covariance=moving, **odometry)
    yield "odometry_enu_flu", frame(
        std, "odometry", 1, 1, 28, frame_id=4, child_frame_id=13, pose_covariance=UNKNOWN, **odometry)
    yield "odometry_global", frame(
        std, "odometry", 1, 1, 29, frame_id=0, child_frame_id=12, pose_covariance=UNKNOWN, **odometry)
    yield "local_position_ned", frame(
        std, "local_position_ned", 1, 197, 30, time_boot_ms=10000, x=2.0, y=1.0, z=0.0, vx=0.25, vy=0.5, vz=0.0)
    yield "attitude", frame(std, "attitude", 1, 197, 31, **ATTITUDE)
    status = dict(
        time_usec=11000000, vel_ratio=0.0, pos_horiz_ratio=0.75, pos_vert_ratio=0.0, mag_ratio=0.0, hagl_ratio=0.0,
        tas_ratio=0.0, pos_horiz_accuracy=0.125, pos_vert_accuracy=0.0)
    yield "estimator_status", frame(std, "estimator_status", 1, 197, 32, flags=1 | 2 | 8 | 16, **status)
    yield "estimator_status_dead_reckoning", frame(std, "estimator_status", 1, 197, 33, flags=1 | 8, **status)


def component_cases(std):
    nothing = [0] * 8
    yield "autopilot_version", frame(
        std, "autopilot_version", 1, 1, 43, capabilities=0x2018, flight_sw_version=0x01020380, middleware_sw_version=0,
        os_sw_version=0, board_version=0, flight_custom_version=nothing, middleware_custom_version=nothing,
        os_custom_version=nothing, vendor_id=0, product_id=0, uid=0)
    yield "protocol_version", frame(
        std, "protocol_version", 1, 197, 44, version=200, min_version=100, max_version=200,
        spec_version_hash=nothing, library_version_hash=nothing)
    yield "component_information_basic", frame(
        std, "component_information_basic", 1, 197, 45, capabilities=0x2018, time_boot_ms=123456, time_manufacture_s=0,
        vendor_name=b"an open source project", model_name=b"thirty-one bytes of a model nam", software_version=b"1.2.3-rc.1",
        hardware_version=b"", serial_number=b"")
    yield "message_interval", frame(std, "message_interval", 1, 197, 46, message_id=331, interval_us=200000)
    yield "message_interval_disabled", frame(std, "message_interval", 1, 197, 47, message_id=42102, interval_us=-1)
    data = [0.0] * 58
    data[0], data[2], data[5] = 1.5, -0.25, 1e-9
    yield "debug_float_array", frame(
        std, "debug_float_array", 1, 197, 48, time_usec=5000001, name=b"tencharact", array_id=3, data=data)
    yield "debug_float_array_empty", frame(
        std, "debug_float_array", 1, 197, 49, time_usec=5000001, name=b"camera", array_id=65535, data=[0.0] * 58)
    yield "set_mode", frame(std, "set_mode", 255, 190, 92, target_system=1, base_mode=209, custom_mode=4 << 16 | 5 << 24)
    yield "command_int", frame(
        std, "command_int", 255, 190, 50, target_system=1, target_component=197, frame=20, command=65000, current=0,
        autocontinue=0, param1=1.0, param2=2.0, param3=3.0, param4=-4.0, x=-2147483648, y=70000, z=7.5)
    yield "statustext_second_part", frame(
        std, "statustext", 1, 197, 51, severity=6, text=b"of two", id=513, chunk_seq=1)


def service_cases(std):
    """What a ground station asks of a vehicle beside parameters and commands, and the answers."""
    vehicle = dict(target_system=1, target_component=1)
    ground = dict(target_system=255, target_component=190)
    yield "mission_request_list", frame(std, "mission_request_list", 255, 190, 60, mission_type=2, **vehicle)
    yield "mission_request_partial_list", frame(
        std, "mission_request_partial_list", 255, 190, 61, start_index=3, end_index=-1, mission_type=1, **vehicle)
    yield "mission_write_partial_list", frame(
        std, "mission_write_partial_list", 255, 190, 62, start_index=-2, end_index=300, mission_type=0, **vehicle)
    yield "mission_request", frame(std, "mission_request", 255, 190, 63, seq=513, mission_type=1, **vehicle)
    yield "mission_request_int", frame(std, "mission_request_int", 255, 190, 64, seq=65535, mission_type=0, **vehicle)
    yield "mission_set_current", frame(std, "mission_set_current", 255, 190, 65, seq=258, **vehicle)
    yield "mission_current_none", frame(
        std, "mission_current", 1, 1, 66, seq=0, total=65535, mission_state=1, mission_mode=0, mission_id=0, fence_id=0,
        rally_points_id=0)
    yield "mission_count", frame(std, "mission_count", 255, 190, 67, count=513, mission_type=2, opaque_id=0, **vehicle)
    yield "mission_count_none", frame(std, "mission_count", 1, 1, 68, count=0, mission_type=0, opaque_id=0, **ground)
    yield "mission_clear_all", frame(std, "mission_clear_all", 255, 190, 69, mission_type=255, **vehicle)
    yield "mission_ack", frame(std, "mission_ack", 1, 1, 70, type=13, mission_type=1, opaque_id=0, **ground)
    item = dict(seq=258, current=1, autocontinue=1, param1=2.5, param2=0.25, param3=0.0, param4=-90.0, z=1.5, **vehicle)
    yield "mission_item", frame(
        std, "mission_item", 255, 190, 81, frame=1, command=16, x=1.25, y=-2.5, mission_type=0, **item)
    yield "mission_item_int", frame(
        std, "mission_item_int", 255, 190, 82, frame=6, command=16, x=520115001, y=-1234567, mission_type=0, **item)
    yield "mission_item_int_of_unlisted_command", frame(
        std, "mission_item_int", 255, 190, 83, frame=99, command=65000, x=-2147483648, y=2147483647, mission_type=2, **item)
    yield "mission_item_reached", frame(std, "mission_item_reached", 1, 1, 84, seq=258)
    yield "mission_current_active", frame(
        std, "mission_current", 1, 1, 85, seq=2, total=4, mission_state=3, mission_mode=0, mission_id=0, fence_id=0,
        rally_points_id=0)
    yield "command_int_reposition", frame(
        std, "command_int", 255, 190, 86, target_system=1, target_component=1, frame=5, command=192, current=0,
        autocontinue=0, param1=-1.0, param2=1.0, param3=0.0, param4=0.5, x=520115001, y=43571002, z=7.5)
    yield "command_ack_of_command_int_only", frame(
        std, "command_ack", 1, 1, 87, command=192, result=8, progress=0, result_param2=0,
        target_system=255, target_component=190)
    header = [0x02, 0x01, 7, 4, 12, 0, 0, 0, 1, 2, 3, 4]
    path = list(b"/folder/file")
    yield "file_transfer_open", frame(
        std, "file_transfer_protocol", 255, 190, 71, target_network=0, payload=header + path + [0] * (239 - len(path)), **vehicle)
    header = [0xFF, 0xFF, 0, 128, 239, 15, 1, 0, 0, 0, 0, 0x80]
    yield "file_transfer_burst", frame(
        std, "file_transfer_protocol", 1, 1, 72, target_network=0, payload=header + list(range(1, 240)), **ground)
    yield "log_request_list", frame(std, "log_request_list", 255, 190, 73, start=1, end=65535, **vehicle)
    yield "log_entry", frame(
        std, "log_entry", 1, 1, 74, id=258, num_logs=772, last_log_num=1286, time_utc=1700000000, size=16909060)
    yield "log_request_data", frame(std, "log_request_data", 255, 190, 75, id=258, ofs=16909060, count=4294967295, **vehicle)
    yield "log_data", frame(std, "log_data", 1, 1, 76, id=258, ofs=16909060, count=3, data=[7, 0, 9] + [0] * 87)
    yield "param_hash", frame(
        std, "param_value", 1, 1, 77, param_id=b"_HASH_CHECK", param_value=struct.unpack("<f", struct.pack("<I", 0x12345678))[0],
        param_type=5, param_count=19, param_index=65535)
    yield "available_mode", frame(
        std, "available_modes", 1, 1, 78, number_modes=3, mode_index=2, standard_mode=1, custom_mode=16909060, properties=6,
        mode_name=b"thirty-four bytes of the name of a")
    yield "component_metadata", frame(
        std, "component_metadata", 1, 1, 79, time_boot_ms=123456, file_crc=0x89ABCDEF, uri=b"mftp:///general.json")
    yield "component_information", frame(
        std, "component_information", 1, 1, 80, time_boot_ms=123456, general_metadata_file_crc=0x89ABCDEF,
        general_metadata_uri=b"mftp:///general.json", peripherals_metadata_file_crc=0, peripherals_metadata_uri=b"")


def v1_cases(std):
    yield "v1_heartbeat", frame(std, "heartbeat", 1, 1, 0, **HEARTBEAT)
    yield "v1_attitude", frame(std, "attitude", 1, 1, 1, **ATTITUDE)
    yield "v1_command_ack", frame(std, "command_ack", 1, 1, 2, command=511, result=0)


def main():
    own = load(sys.argv[1], "2.0")
    std = load(sys.argv[2], "2.0")
    std_v1 = load(sys.argv[2], "1.0")
    ardupilot = load(sys.argv[3], "2.0")
    cases = {}
    for group in (own_cases(own), conversation_cases(std), sensor_cases(std), pose_cases(std), v1_cases(std_v1),
                  thermometer_cases(std), request_cases(std), component_cases(std),
                  vehicle_cases(std, ardupilot), display_cases(std), service_cases(std)):
        cases.update(group)
    json.dump(cases, sys.stdout, indent=1)
    print()


if __name__ == "__main__":
    main()

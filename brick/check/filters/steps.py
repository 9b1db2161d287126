"""Runs a filter of posebridge_filters.py over rows of numbers, as steps.c does in C. `answers(title, rows)` is a list per row."""

import posebridge_filters as filters

ROBOT = (0.0281, 0.0279, 0.1115, 0.01745329252)


def begun(title):
    robot, start = filters.Robot(*ROBOT), filters.State(0.2, -0.1, 0.3)
    if title == "wheel":
        return filters.WheelFilter(robot, start)
    if title == "speed":
        return filters.SpeedFilter(robot, start, 0.05)
    if title == "ekf5":
        return filters.Ekf5(robot, start, 0.01, 0.02, 0.002)
    if title == "thermometer":
        return filters.Thermometer(20, 0.03)
    return filters.Wall(0.81633, 0.35346)


def drive_step(title, found, row, is_first):
    sensors = int(row[6])
    felt = row[3:5] if sensors & 1 else [0.0, 0.0]
    if is_first:
        if title != "wheel":
            found.feel(*felt)
    elif title == "wheel":
        found.step(*row[:3])
    elif title == "speed":
        found.step(*row[:3], *felt)
    else:
        found.step(*row[:3], *felt, row[5] if sensors & 2 else None)
    state = found.state
    return [state.x, state.y, state.heading, state.forward, state.turn]


def answers(title, rows):
    found, answered = begun(title), []
    for index, row in enumerate(rows):
        if title == "thermometer":
            found.step(row[0], row[1])
            answered.append([found.u, found.x])
        elif title == "wall":
            found.step(row[0], row[1], row[3] if row[2] > 0 else None)
            answered.append([found.z, found.v, found.p[0], 1.0 if found.gated else 0.0])
        else:
            answered.append(drive_step(title, found, row, index == 0))
    return answered

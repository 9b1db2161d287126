"""The papers' filters for MicroPython (EV3, SPIKE, Pybricks): the steps of brick/filters/*.c, element by element, without a matrix.

Units are SI and radians; left is counter-clockwise. Each step takes what the sensors say since the step before.
"""

import math

DEG = math.pi / 180
INTERVAL_S = 0.05


class Robot:
    def __init__(self, left_radius_m, right_radius_m, track_m, tick_rad=DEG):
        self.left, self.right, self.track, self.tick = left_radius_m, right_radius_m, track_m, tick_rad

    def body(self, left_rad, right_rad):
        """Equation 14: way and turn."""
        left, right = self.left * left_rad, self.right * right_rad
        return (left + right) / 2, (right - left) / self.track


class State:
    def __init__(self, x, y, heading):
        self.x, self.y, self.heading, self.forward, self.turn = x, y, heading, 0.0, 0.0

    def move(self, d, dth):
        """Equation 13."""
        middle = self.heading + dth / 2
        self.x += d * math.cos(middle)
        self.y += d * math.sin(middle)
        self.heading += dth


class WheelFilter:
    """One filter per wheel, equations 15 to 19, in degrees."""

    def __init__(self, robot, start):
        self.robot, self.state = robot, start
        # phi, rate, P (angle, angle with rate, rate), counted, R
        self.wheels = [[0.0, 0.0, 10.0, 0.0, 10.0, 0.0, r] for r in (1.5, 2.5)]

    def wheel(self, wheel, dt, turned_rad):
        phi, rate, p0, p1, p2, counted, r = wheel
        share = dt / INTERVAL_S
        counted += turned_rad / DEG
        before = phi
        phi += dt * rate
        p00 = p0 + 2 * dt * p1 + dt * dt * p2 + share * 0.1
        p01 = p1 + dt * p2
        p11 = p2 + share * 10
        s = p00 + r
        nu = counted - phi
        phi += p00 / s * nu
        rate += p01 / s * nu
        wheel[:] = [phi, rate, p00 * r / s, p01 * r / s, p11 - p01 * p01 / s, counted, r]
        return (phi - before) * DEG, rate * DEG

    def step(self, dt, left_rad, right_rad):
        left, left_rate = self.wheel(self.wheels[0], dt, left_rad)
        right, right_rate = self.wheel(self.wheels[1], dt, right_rad)
        self.state.move(*self.robot.body(left, right))
        self.state.forward, self.state.turn = self.robot.body(left_rate, right_rate)


class SpeedFilter:
    """v and w driven by accelerometers, equations 13 and 20 to 23, with matrices from the robot."""

    def __init__(self, robot, start, accelerometer_m_s2):
        self.robot, self.state = robot, start
        count = (robot.left + robot.right) / 2 * robot.tick / INTERVAL_S
        felt = accelerometer_m_s2 * INTERVAL_S
        self.r = (count**2 / 12, (count / robot.track) ** 2 / 3)
        self.q = (felt**2 / 2, 2 * (felt / robot.track) ** 2)
        self.p = list(self.r)
        self.a = self.alpha = 0.0

    def feel(self, left_m_s2, right_m_s2):
        self.a = (left_m_s2 + right_m_s2) / 2
        self.alpha = (right_m_s2 - left_m_s2) / self.robot.track

    def scalar(self, row, x, share, seen):
        p = self.p[row] + share * self.q[row]
        k = p / (p + self.r[row])
        self.p[row] = p * (1 - k)
        return x + k * (seen - x)

    def step(self, dt, left_rad, right_rad, left_m_s2=0.0, right_m_s2=0.0):
        state, share = self.state, dt / INTERVAL_S
        state.move(state.forward * dt, state.turn * dt)
        d, dth = self.robot.body(left_rad, right_rad)
        state.forward = self.scalar(0, state.forward + self.a * dt, share, d / dt)
        state.turn = self.scalar(1, state.turn + self.alpha * dt, share, dth / dt)
        self.feel(left_m_s2, right_m_s2)


class Ekf5:
    """x, y, heading, v, w: equations 24 to 26."""

    Q = (2e-4, 2e-4, 0.1 * DEG**2, 3e-4, DEG**2)
    R = (5.1e-4, 0.938 * DEG**2, 0.332 * DEG**2)

    def __init__(self, robot, start, sigma_m, sigma_rad, gyro_bias=0.0):
        self.robot, self.state, self.gyro_bias = robot, start, gyro_bias
        diagonal = (sigma_m**2, sigma_m**2, sigma_rad**2, 0.05e-4, 0.05 * DEG**2)
        self.p = [[diagonal[i] if i == j else 0.0 for j in range(5)] for i in range(5)]
        self.a = self.alpha = 0.0
        self.wheel_heading = self.gyro_heading = start.heading

    def feel(self, left_m_s2, right_m_s2):
        self.a = (left_m_s2 + right_m_s2) / 2
        self.alpha = (right_m_s2 - left_m_s2) / self.robot.track

    def predict(self, t):
        s, p = self.state, self.p
        middle = s.heading + t * s.turn / 2
        b, e = t * math.cos(middle), t * math.sin(middle)
        a, d = -s.forward * e, s.forward * b
        c, g = t * a / 2, t * d / 2
        for i in range(5):  # F P
            p[0][i] += a * p[2][i] + b * p[3][i] + c * p[4][i]
            p[1][i] += d * p[2][i] + e * p[3][i] + g * p[4][i]
            p[2][i] += t * p[4][i]
        for row in p:  # (F P) F'
            row[0] += a * row[2] + b * row[3] + c * row[4]
            row[1] += d * row[2] + e * row[3] + g * row[4]
            row[2] += t * row[4]
        for i in range(5):
            p[i][i] += t / INTERVAL_S * self.Q[i]
        s.x += s.forward * b
        s.y += s.forward * e
        s.heading += t * s.turn
        s.forward += t * self.a
        s.turn += t * self.alpha

    def use(self, row, seen, r):
        state, p = self.state, self.p
        column = [p[i][row] for i in range(5)]
        s = column[row] + r
        g = (seen - (state.heading if row == 2 else state.forward)) / s
        state.x += column[0] * g
        state.y += column[1] * g
        state.heading += column[2] * g
        state.forward += column[3] * g
        state.turn += column[4] * g
        for i in range(5):
            k = column[i] / s
            for j in range(5):
                p[i][j] -= k * column[j]

    def step(self, dt, left_rad, right_rad, left_m_s2=0.0, right_m_s2=0.0, gyro_rad_s=None):
        self.predict(dt)
        d, dth = self.robot.body(left_rad, right_rad)
        self.wheel_heading += dth
        self.use(3, d / dt, self.R[0])
        self.use(2, self.wheel_heading, self.R[1])
        self.feel(left_m_s2, right_m_s2)
        if gyro_rad_s is not None:
            self.gyro_heading += (gyro_rad_s - self.gyro_bias) * dt
            self.use(2, self.gyro_heading, self.R[2])


class Thermometer:
    """Paper 2: u is the final value, x what is left of the transient; P = U D U' as in posebridge_slow_sensor.h."""

    def __init__(self, tau_s, sigma_k):
        self.tau, self.r, self.u = tau_s, sigma_k**2, None

    def step(self, dt, shown):
        if self.u is None:
            self.u, self.x, self.b = shown, 0.0, 0.0
            self.d_u = self.d_x = 1e10 * self.r
        else:
            decay = math.exp(-dt / self.tau)
            self.x *= decay
            self.d_x *= decay * decay
            self.b /= decay
            if self.d_x <= 1e-20 * self.r:
                self.d_x = self.b = 0.0
        f = self.b + 1
        v_x = self.d_x * f
        s_u = self.r + self.d_u
        s = s_u + v_x * f
        nu = shown - self.u - self.x
        self.u += (self.d_u + v_x * self.b) / s * nu
        self.x += v_x / s * nu
        self.b -= f * self.d_u / s_u
        self.d_u *= self.r / s_u
        self.d_x *= s_u / s


class Wall:
    """Paper 3: z distance, v speed towards the wall, with the gate."""

    def __init__(self, drag, mass, range_m=0.02, process_m=0.05, gate_m=0.1):
        self.d, self.m, self.r, self.q, self.gate = drag, mass, range_m**2, process_m**2, gate_m
        self.z, self.v, self.gated, self.input = None, 0.0, False, 0.0

    def predict(self, dt):
        rate = self.d / self.m
        g, e, moved, gained = dt, 1 - rate * dt, 0.0, dt / self.m
        if dt > 0.1 or rate * dt > 1:
            e = math.exp(-rate * dt)
            g = (1 - e) / rate
            moved, gained = -(dt - g) / self.d, (1 - e) / self.d
        self.z += moved * self.input - g * self.v
        self.v = e * self.v + gained * self.input
        p0, p1, p2 = self.p
        self.p = (p0 + g * (g * p2 - 2 * p1) + self.q, e * (p1 - g * p2), e * e * p2 + self.q)

    def step(self, dt, motor, range_m=None):
        if self.z is not None:
            self.predict(dt)
            self.gated = False
            if range_m is not None:
                self.use(range_m)
        elif range_m is not None:
            self.z, self.p = range_m, (self.q, 0.0, self.q)
        self.input = motor

    def use(self, range_m):
        p0, p1, p2 = self.p
        s = p0 + self.r
        nu = range_m - self.z
        self.gated = nu * nu > 9 * s and abs(nu) > self.gate
        if not self.gated:
            self.z += p0 / s * nu
            self.v += p1 / s * nu
            self.p = (p0 - p0 / s * p0, p1 - p0 / s * p1, p2 - p1 / s * p1)

// A robot with two driven wheels, an encoder on each and an MPU-6050: reports 50 times per second, hears where it is.
//
// Wiring (Uno, Nano): left encoder A on 2 and B on 4, right encoder A on 3 and B on 5, MPU-6050 on A4 (SDA) and A5 (SCL). The
// station is on the USB serial port at 115200 baud:  posebridge run --link 'serial:///dev/ttyUSB0?baud=115200'
//
// Nothing may be printed to Serial beside the frames.

#include <PosebridgeBrick.h>
#include <Wire.h>

// How the robot is built: change these.
static const pb_description ROBOT PROGMEM = {
    0.0325f, // radius of the left wheel, m: roll ten turns along a ruler
    0.0325f, // of the right one
    0.150f,  // track width, m: turn ten times on the spot, do not measure with a ruler
    1440.0f, // counts per turn of a wheel, as they are counted below
    0.0009f, // noise of the gyro, rad/s: MPU-6050, 0.05 degrees/s rms behind its low-pass of 98 Hz (datasheet, 6.1)
    0.0f,    // its resolution is fine
    "arduino-2wd"};
static const uint8_t LEFT_A = 2, LEFT_B = 4, RIGHT_A = 3, RIGHT_B = 5;

static const uint32_t PERIOD_US = 20000;
static const uint8_t PERIODS_PER_HEARTBEAT = 50, PERIODS_PER_DESCRIPTION = 250;

// MPU-6050: address, registers, and 131 counts per degree/s at the range of 250 degrees/s (register map, sections 4.4 and 4.19).
static const uint8_t MPU = 0x68, PWR_MGMT_1 = 0x6B, CONFIG = 0x1A, GYRO_ZOUT_H = 0x47;
// Microradians per second of a count, times 16: pi / 180 / 131 * 1e6 * 16.
static const int32_t URAD_PER_S_TIMES_16 = 2132;

static pb_link robot;
static pb_receiver receiver;
static pb_gyro gyro;
static pb_pose estimate;
static volatile int32_t left_count, right_count;

// Two counts per line of the encoder. Swap A and B of a wheel that counts backwards when it is rolled forwards.
static void left_edge()
{
    left_count += digitalRead(LEFT_A) == digitalRead(LEFT_B) ? 1 : -1;
}

static void right_edge()
{
    right_count += digitalRead(RIGHT_A) == digitalRead(RIGHT_B) ? -1 : 1;
}

static void write_gyro(uint8_t place, uint8_t value)
{
    Wire.beginTransmission(MPU);
    Wire.write(place);
    Wire.write(value);
    Wire.endTransmission();
}

// Samples the gyro about the vertical axis. A sensor that does not answer adds nothing.
static void sample_gyro()
{
    Wire.beginTransmission(MPU);
    Wire.write(GYRO_ZOUT_H);
    Wire.endTransmission(false);
    uint32_t now_us = micros();
    if (Wire.requestFrom(MPU, (uint8_t)2) != 2)
        return;
    uint8_t high = Wire.read();
    int16_t counts = (int16_t)((uint16_t)high << 8 | (uint8_t)Wire.read());
    pb_gyro_sample(&gyro, now_us, counts * URAD_PER_S_TIMES_16 / 16);
}

// Counts and their time, taken together while no edge can come between them.
static pb_ticks sample_wheels()
{
    pb_ticks ticks;
    noInterrupts();
    ticks.left = left_count;
    ticks.right = right_count;
    ticks.time_us = micros();
    interrupts();
    ticks.flags = PB_BOTH;
    return ticks;
}

static void send_motion()
{
    pb_ticks ticks = sample_wheels();
    pb_send_ticks(&robot, &ticks);
    pb_inertial inertial;
    if (pb_gyro_take(&gyro, &inertial))
        pb_send_inertial(&robot, &inertial);
}

static void send_description()
{
    pb_description description;
    memcpy_P(&description, &ROBOT, sizeof description);
    pb_send_description(&robot, &description);
}

// Your robot steers here: the estimate is always a little old, estimate.time_us says how old.
static void steer()
{
    const uint8_t both = PB_POSITION_VALID | PB_HEADING_VALID;
    digitalWrite(LED_BUILTIN, (estimate.flags & both) == both ? HIGH : LOW);
}

void setup()
{
    pinMode(LED_BUILTIN, OUTPUT);
    pinMode(LEFT_A, INPUT_PULLUP);
    pinMode(LEFT_B, INPUT_PULLUP);
    pinMode(RIGHT_A, INPUT_PULLUP);
    pinMode(RIGHT_B, INPUT_PULLUP);
    attachInterrupt(digitalPinToInterrupt(LEFT_A), left_edge, CHANGE);
    attachInterrupt(digitalPinToInterrupt(RIGHT_A), right_edge, CHANGE);
    Wire.begin();
    Wire.setClock(400000);
    write_gyro(PWR_MGMT_1, 1); // awake, clocked by the gyro about x
    write_gyro(CONFIG, 2); // low-pass at 98 Hz, for which the noise above holds
    Serial.begin(115200);
    pb_begin(&robot, pb_print, &Serial, 1, 1);
}

void loop()
{
    static uint32_t due_us = micros();
    static uint8_t periods = 0;
    while (Serial.available() > 0)
        if (pb_receive(&robot, &receiver, (uint8_t)Serial.read(), micros(), &estimate))
            steer();
    if ((int32_t)(micros() - due_us) < 0)
        return;
    due_us += PERIOD_US;
    sample_gyro();
    send_motion();
    if (periods % PERIODS_PER_HEARTBEAT == 0)
        pb_send_heartbeat(&robot);
    if (periods == 0)
        send_description();
    periods = (uint8_t)((periods + 1) % PERIODS_PER_DESCRIPTION);
}

/*
 * Runs every filter over an exported file of sensor data and prints what each believes after each row.
 *
 *   cc -std=c99 -O2 replay.c posebridge_filters.c posebridge_indirect.c -lm -o replay
 *   ./replay track_m=0.112 < drive.csv > beliefs.csv
 *
 * The file is that of `posebridge lab nxt-square --export drive.csv`; docs/lab/square.md has its columns. Robot, start and noise are
 * given as key=value, SI; the names and what they are without that stand in `settings` below.
 */
#include "posebridge_filters.h"
#include "posebridge_indirect.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define LONGEST_LINE 4096
#define MOST_COLUMNS 64

/* What can be set. A LEGO NXT with wheels of 56 mm, and the noise of the simulated drives. */
static struct {
    double left_radius_m, right_radius_m, track_m, tick_rad;
    double x_m, y_m, heading_rad, position_sigma_m, heading_sigma_rad;
    double wheel_m_sqrt_m, travel_m_sqrt_m, turn_rad_sqrt_rad, heading_rad_sqrt_m;
    double gyro_rad_s, gyro_resolution_rad_s, bias_rad_s, bias_sigma_rad_s, bias_walk_rad_s_sqrt_s;
    double accel_m_s2, turn_accel_rad_s2, accelerometer_m_s2;
    double radius_scale, radius_difference, track_scale;
} set = {0.028, 0.028, 0.112, 0.017453292519943295,
         0, 0, 0, 1e-4, 1e-4,
         0.0008, 0, 0.004, 0,
         0.010471975511965978, 0.017453292519943295, 0, 0.0017453292519943296, 0.00017453292519943296,
         1, 6, 0.05,
         0.002, 0.0002, 0.03};

static const struct {
    const char *name;
    double *value;
} settings[] = {
    {"left_radius_m", &set.left_radius_m},
    {"right_radius_m", &set.right_radius_m},
    {"track_m", &set.track_m},
    {"tick_rad", &set.tick_rad},
    {"x_m", &set.x_m},
    {"y_m", &set.y_m},
    {"heading_rad", &set.heading_rad},
    {"position_sigma_m", &set.position_sigma_m},
    {"heading_sigma_rad", &set.heading_sigma_rad},
    {"wheel_m_sqrt_m", &set.wheel_m_sqrt_m},
    {"travel_m_sqrt_m", &set.travel_m_sqrt_m},
    {"turn_rad_sqrt_rad", &set.turn_rad_sqrt_rad},
    {"heading_rad_sqrt_m", &set.heading_rad_sqrt_m},
    {"gyro_rad_s", &set.gyro_rad_s},
    {"gyro_resolution_rad_s", &set.gyro_resolution_rad_s},
    {"bias_rad_s", &set.bias_rad_s},
    {"bias_sigma_rad_s", &set.bias_sigma_rad_s},
    {"bias_walk_rad_s_sqrt_s", &set.bias_walk_rad_s_sqrt_s},
    {"accel_m_s2", &set.accel_m_s2},
    {"turn_accel_rad_s2", &set.turn_accel_rad_s2},
    {"accelerometer_m_s2", &set.accelerometer_m_s2},
    {"radius_scale", &set.radius_scale},
    {"radius_difference", &set.radius_difference},
    {"track_scale", &set.track_scale},
};
#define SETTINGS (sizeof settings / sizeof settings[0])

enum { TIME, LEFT, RIGHT, GYRO, ACCEL_LEFT, ACCEL_RIGHT, COLUMNS };
static const char *const names[COLUMNS] = {"time_s", "left_counts", "right_counts", "gyro_deg_per_s", "accel_left_m_per_s2", "accel_right_m_per_s2"};

static int fail(const char *what, const char *which)
{
    fprintf(stderr, "replay: %s `%s`\n", what, which);
    return 2;
}

static int take_setting(const char *text)
{
    const char *equals = strchr(text, '=');
    size_t i;
    char *end;
    if (equals == NULL) return 0;
    for (i = 0; i < SETTINGS; i++) {
        size_t length = strlen(settings[i].name);
        if (length == (size_t)(equals - text) && strncmp(text, settings[i].name, length) == 0) {
            *settings[i].value = strtod(equals + 1, &end);
            return end != equals + 1 && *end == '\0' && isfinite(*settings[i].value);
        }
    }
    return 0;
}

/* Cuts a line at its commas; the cells stay in the line. */
static int cut(char *line, char *cells[MOST_COLUMNS])
{
    int count = 0;
    char *hash = strchr(line, '#');
    if (hash != NULL) *hash = '\0';
    line[strcspn(line, "\r\n")] = '\0';
    if (line[0] == '\0') return 0;
    for (;;) {
        char *comma = strchr(line, ',');
        if (count == MOST_COLUMNS) return -1;
        cells[count++] = line;
        if (comma == NULL) return count;
        *comma = '\0';
        line = comma + 1;
    }
}

/* A number of a row; 0 where the cell is empty or the column is missing. */
static int number(char *cells[], const int place[], int count, int column, double *value)
{
    char *end;
    if (place[column] < 0 || place[column] >= count || cells[place[column]][0] == '\0') return 0;
    *value = strtod(cells[place[column]], &end);
    return *end == '\0' && isfinite(*value);
}

static pb_wheel_kf wheels;
static pb_speed_kf speeds[2];
static pb_ekf5 five[2];
static pb_ekf9 nine;
static pb_indirect indirect[2]; /* feed-forward, feedback */

static void begin(const pb_robot *robot)
{
    pb_state start = {0, 0, 0, 0, 0};
    pb_real sigma[2];
    pb_speed_matrices printed = pb_speed_printed(), speed = pb_speed_corrected(robot, (pb_real)set.accelerometer_m_s2);
    pb_ekf5_matrices as_printed = pb_ekf5_printed(), swapped = pb_ekf5_swapped();
    pb_noise noise;
    pb_indirect_settings settled;
    int i;

    start.x_m = (pb_real)set.x_m;
    start.y_m = (pb_real)set.y_m;
    start.heading_rad = (pb_real)set.heading_rad;
    sigma[0] = (pb_real)set.position_sigma_m;
    sigma[1] = (pb_real)set.heading_sigma_rad;
    noise.wheel_m_sqrt_m = (pb_real)set.wheel_m_sqrt_m;
    noise.travel_m_sqrt_m = (pb_real)set.travel_m_sqrt_m;
    noise.turn_rad_sqrt_rad = (pb_real)set.turn_rad_sqrt_rad;
    noise.heading_rad_sqrt_m = (pb_real)set.heading_rad_sqrt_m;
    noise.gyro_rad_s = (pb_real)set.gyro_rad_s;
    noise.gyro_resolution_rad_s = (pb_real)set.gyro_resolution_rad_s;
    noise.bias_rad_s = (pb_real)set.bias_rad_s;
    noise.bias_sigma_rad_s = (pb_real)set.bias_sigma_rad_s;
    noise.bias_walk_rad_s_sqrt_s = (pb_real)set.bias_walk_rad_s_sqrt_s;
    noise.accel_m_s2 = (pb_real)set.accel_m_s2;
    noise.turn_accel_rad_s2 = (pb_real)set.turn_accel_rad_s2;

    pb_wheel_kf_init(&wheels, &pb_wheel_printed, &start);
    pb_speed_kf_init(&speeds[0], &printed, &start);
    pb_speed_kf_init(&speeds[1], &speed, &start);
    pb_ekf5_init(&five[0], &as_printed, &start, sigma);
    pb_ekf5_init(&five[1], &swapped, &start, sigma);
    five[0].gyro_bias_rad_s = five[1].gyro_bias_rad_s = (pb_real)set.bias_rad_s;
    pb_ekf9_init(&nine, robot, &noise, &start, sigma);
    settled.noise = noise;
    settled.accelerometer_m_s2 = (pb_real)set.accelerometer_m_s2;
    settled.radius_scale = (pb_real)set.radius_scale;
    settled.radius_difference = (pb_real)set.radius_difference;
    settled.track_scale = (pb_real)set.track_scale;
    for (i = 0; i < 2; i++) {
        settled.feedback = i;
        pb_indirect_init(&indirect[i], robot, &settled, &start, sigma);
    }
}

static int step(const pb_robot *robot, const pb_reading *reading)
{
    int used = pb_wheel_kf_step(&wheels, robot, reading), i;
    for (i = 0; i < 2; i++) {
        used &= pb_speed_kf_step(&speeds[i], robot, reading);
        used &= pb_ekf5_step(&five[i], robot, reading);
        used &= pb_indirect_step(&indirect[i], robot, reading);
    }
    return used & pb_ekf9_step(&nine, robot, reading);
}

/* The first row is the base: the wheels turn from there. */
static int base(const pb_robot *robot, const pb_reading *first)
{
    int used = 1, i;
    for (i = 0; i < 2; i++) {
        used &= pb_speed_kf_begin(&speeds[i], robot, first) & pb_ekf5_begin(&five[i], robot, first);
        used &= pb_indirect_begin(&indirect[i], robot, first);
    }
    return used & pb_ekf9_begin(&nine, robot, first);
}

static void print_state(const char *name, const pb_state *s)
{
    printf(",%s,%.17g,%.17g,%.17g,%.17g,%.17g", name, (double)s->x_m, (double)s->y_m, (double)s->heading_rad, (double)s->forward_m_s, (double)s->turn_rad_s);
}

static void print_beliefs(double time_s)
{
    int i;
    printf("%.17g", time_s);
    print_state("wheel-kf", &wheels.state);
    print_state("velocity-kf", &speeds[0].state);
    print_state("velocity-kf own", &speeds[1].state);
    print_state("ekf5", &five[0].state);
    print_state("ekf5 swapped", &five[1].state);
    print_state("ekf5-corrected", &nine.state);
    print_state("indirect", &indirect[0].state);
    print_state("indirect-feedback", &indirect[1].state);
    printf(",P of ekf5");
    for (i = 0; i < 5; i++) printf(",%.17g", (double)five[0].p[i][i]);
    printf(",P of ekf5-corrected");
    for (i = 0; i < 5; i++) printf(",%.17g", (double)nine.p[i][i]);
    printf("\n");
}

/* Finds the columns by their names. */
static int find_columns(char *cells[], int count, int place[COLUMNS])
{
    int i, j;
    for (i = 0; i < COLUMNS; i++) {
        place[i] = -1;
        for (j = 0; j < count; j++)
            if (strcmp(cells[j], names[i]) == 0) place[i] = j;
        if (place[i] < 0 && i <= RIGHT) return fail("there is no column", names[i]);
    }
    return 0;
}

int main(int argc, char **argv)
{
    char line[LONGEST_LINE];
    char *cells[MOST_COLUMNS];
    int place[COLUMNS], count, i, has_header = 0, has_base = 0;
    double before[3] = {0, 0, 0}, value[COLUMNS];
    pb_robot robot;

    for (i = 1; i < argc; i++)
        if (!take_setting(argv[i])) return fail("not a setting, or not a number:", argv[i]);
    robot.left_radius_m = (pb_real)set.left_radius_m;
    robot.right_radius_m = (pb_real)set.right_radius_m;
    robot.track_m = (pb_real)set.track_m;
    robot.tick_rad = (pb_real)set.tick_rad;
    begin(&robot);
    while (fgets(line, sizeof line, stdin) != NULL) {
        pb_reading reading;
        if (strchr(line, '\n') == NULL && !feof(stdin)) return fail("a line is too long:", line);
        count = cut(line, cells);
        if (count < 0) return fail("too many columns in the line that begins with", line);
        if (count == 0) continue;
        if (!has_header) {
            if (find_columns(cells, count, place) != 0) return 2;
            has_header = 1;
            continue;
        }
        for (i = TIME; i <= RIGHT; i++)
            if (!number(cells, place, count, i, &value[i])) return fail("no number in the row of time", cells[0]);
        reading.present = 0;
        reading.left_m_s2 = reading.right_m_s2 = reading.gyro_rad_s = 0;
        if (number(cells, place, count, GYRO, &value[GYRO])) {
            reading.present |= PB_GYRO;
            reading.gyro_rad_s = (pb_real)(value[GYRO] * 0.017453292519943295);
        }
        if (number(cells, place, count, ACCEL_LEFT, &value[ACCEL_LEFT]) && number(cells, place, count, ACCEL_RIGHT, &value[ACCEL_RIGHT])) {
            reading.present |= PB_ACCELERATIONS;
            reading.left_m_s2 = (pb_real)value[ACCEL_LEFT];
            reading.right_m_s2 = (pb_real)value[ACCEL_RIGHT];
        }
        /* Differences are taken before they are rounded to the filters' precision. */
        reading.dt_s = (pb_real)(value[TIME] - before[TIME]);
        reading.left_rad = (pb_real)((value[LEFT] - before[LEFT]) * set.tick_rad);
        reading.right_rad = (pb_real)((value[RIGHT] - before[RIGHT]) * set.tick_rad);
        if (!(has_base ? step(&robot, &reading) : base(&robot, &reading))) return fail("a filter refused the row of time", cells[place[TIME]]);
        has_base = 1;
        for (i = TIME; i <= RIGHT; i++) before[i] = value[i];
        print_beliefs(value[TIME]);
    }
    return has_header ? 0 : fail("there is no line with", "time_s,left_counts,right_counts");
}

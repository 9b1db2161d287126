/* A webcam without hardware, for LD_PRELOAD: it answers what a program asks of one device file, as the kernel's "Video for Linux API"
 * says, and leaves every other file to the C library. Where the API leaves a choice it does what the kernel's driver of USB webcams does.
 *
 * It is set by environment variables:
 *   SIMULATED_WEBCAM            a folder, see below
 *   SIMULATED_WEBCAM_PATH       path of the device file, which need not exist
 *   SIMULATED_WEBCAM_STAMPS     start (of exposure) or end (of the frame)
 *   SIMULATED_WEBCAM_LACKS      words: exposure (its controls), interval (VIDIOC_G_PARM and VIDIOC_S_PARM), capture (the device
 *                               file is that for metadata), pictures (none comes, and the patience of poll() ends at once)
 *   SIMULATED_WEBCAM_BUS_ERROR  errno of VIDIOC_STREAMON
 *
 * The folder holds a folder WIDTHxHEIGHT for each size, with pictures that are shown in the order of their names: MJPG if they end in
 * .jpg, YUYV of grey ones if they end in .pgm. One that has `damaged` in its name is flagged so. The webcam is plugged in while the file
 * `plugged` is there. What happens is appended to the file `log`: formats, intervals, controls, and for each filled buffer
 * `frame PICTURE MIDDLE`, the middle of its exposure in microseconds of CLOCK_MONOTONIC. */
#define _GNU_SOURCE
#include <dirent.h>
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <linux/videodev2.h>
#include <poll.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/sysmacros.h>
#include <time.h>
#include <unistd.h>

enum { MAX_SIZES = 4, MAX_PICTURES = 16, MAX_BUFFERS = 32, MAX_HANDLES = 16, SECOND_US = 1000000, CONTROLS = 4 };
/* Character device number of all video devices. */
enum { VIDEO_MAJOR = 81 };

struct size {
    uint32_t width, height;
    char folder[PATH_MAX];
    char pictures[MAX_PICTURES][NAME_MAX + 1];
    int count;
};
struct control {
    uint32_t id, type;
    const char *name;
    int32_t minimum, maximum, step, value;
};
/* Given to the program, waiting to be filled, filled. */
enum buffer_state { DEQUEUED, QUEUED, DONE };
struct buffer {
    enum buffer_state state;
    uint32_t bytes, flags, sequence;
    int64_t stamp_us;
    /* The order in which it was queued or filled. */
    uint64_t order;
};
/* An open file. It stays useless once the webcam was unplugged. */
struct handle {
    /* 0 while it is free. */
    int fd;
    struct stat plug;
};

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static struct handle handles[MAX_HANDLES];
static struct size sizes[MAX_SIZES];
static int size_count, size;
static uint32_t pixel_format, bytes_per_line, bytes_per_image, interval_denominator = 30;
static struct buffer buffers[MAX_BUFFERS];
static uint32_t buffer_count;
/* The handle that has set a format or asked for buffers; no other one may until it closes. */
static int owner = -1;
static int streaming;
static int64_t started_us;
static uint32_t frame;
static uint64_t order;

/* As of a usual webcam: no control for automatic gain, steps in the exposure, and slower pictures in the dark. */
static struct control controls[CONTROLS] = {
    { V4L2_CID_GAIN, V4L2_CTRL_TYPE_INTEGER, "gain", 0, 255, 1, 100 },
    { V4L2_CID_EXPOSURE_AUTO, V4L2_CTRL_TYPE_MENU, "exposure_auto", 0, 3, 1, V4L2_EXPOSURE_APERTURE_PRIORITY },
    { V4L2_CID_EXPOSURE_ABSOLUTE, V4L2_CTRL_TYPE_INTEGER, "exposure_absolute", 3, 603, 4, 251 },
    { V4L2_CID_EXPOSURE_AUTO_PRIORITY, V4L2_CTRL_TYPE_BOOLEAN, "exposure_dynamic_framerate", 0, 1, 1, 1 },
};
static struct control *const gain = &controls[0], *const exposure_auto = &controls[1], *const exposure = &controls[2],
                     *const dynamic_rate = &controls[3];

static int is_set(const char *name, const char *word) {
    const char *value = getenv(name);
    return value && strstr(value, word);
}

static const char *in_folder(const char *name) {
    static _Thread_local char path[PATH_MAX];
    snprintf(path, sizeof path, "%s/%s", getenv("SIMULATED_WEBCAM"), name);
    return path;
}

static void write_log(const char *format, ...) {
    FILE *file = fopen(in_folder("log"), "a");
    if (!file) abort();
    va_list values;
    va_start(values, format);
    vfprintf(file, format, values);
    va_end(values);
    fclose(file);
}

static int64_t now_us(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * SECOND_US + now.tv_nsec / 1000;
}

static int is_webcam(const char *path) {
    const char *own = getenv("SIMULATED_WEBCAM_PATH");
    return own && path && strcmp(path, own) == 0;
}

static struct handle *find_handle(int fd) {
    for (int i = 0; i < MAX_HANDLES; i++) {
        if (handles[i].fd == fd) return &handles[i];
    }
    return NULL;
}

static int is_unplugged(const struct handle *handle) {
    struct stat plug;
    return stat(in_folder("plugged"), &plug) != 0 || plug.st_ino != handle->plug.st_ino
        || memcmp(&plug.st_mtim, &handle->plug.st_mtim, sizeof plug.st_mtim) != 0;
}

/* Pictures. */

static int is_visible(const struct dirent *entry) {
    return entry->d_name[0] != '.';
}

static void read_sizes(void) {
    struct dirent **entries, **pictures;
    int count = scandir(getenv("SIMULATED_WEBCAM"), &entries, is_visible, alphasort);
    for (int i = 0; i < count; i++) {
        struct size *found = &sizes[size_count];
        if (size_count == MAX_SIZES || sscanf(entries[i]->d_name, "%ux%u", &found->width, &found->height) != 2) continue;
        snprintf(found->folder, sizeof found->folder, "%s", in_folder(entries[i]->d_name));
        int names = scandir(found->folder, &pictures, is_visible, alphasort);
        for (int k = 0; k < names && k < MAX_PICTURES; k++) {
            snprintf(found->pictures[found->count++], NAME_MAX + 1, "%s", pictures[k]->d_name);
        }
        pixel_format = strstr(found->pictures[0], ".jpg") ? V4L2_PIX_FMT_MJPEG : V4L2_PIX_FMT_YUYV;
        size_count++;
    }
}

/* Brightness of the pixels, with a colour that is none and lines that are longer than the picture is wide. */
static uint32_t fill_yuyv(FILE *file, unsigned char *to) {
    unsigned width, height;
    if (fscanf(file, "P5 %u %u 255", &width, &height) != 2 || fgetc(file) != '\n' || width != sizes[size].width
        || height != sizes[size].height) {
        abort();
    }
    memset(to, 128, bytes_per_image);
    for (unsigned row = 0; row < height; row++) {
        for (unsigned column = 0; column < width; column++) {
            to[row * bytes_per_line + 2 * column] = (unsigned char)fgetc(file);
        }
    }
    return bytes_per_image;
}

static uint32_t fill(uint32_t index, const char *picture) {
    char path[2 * PATH_MAX];
    snprintf(path, sizeof path, "%s/%s", sizes[size].folder, picture);
    FILE *file = fopen(path, "r");
    size_t offset = (size_t)index * bytes_per_image;
    unsigned char *to = mmap(NULL, bytes_per_image, PROT_WRITE, MAP_SHARED, owner, (off_t)offset);
    if (!file || to == MAP_FAILED) abort();
    uint32_t bytes = pixel_format == V4L2_PIX_FMT_MJPEG ? (uint32_t)fread(to, 1, bytes_per_image, file) : fill_yuyv(file, to);
    munmap(to, bytes_per_image);
    fclose(file);
    return bytes;
}

/* The first buffer of a state by order. */
static struct buffer *first_buffer(enum buffer_state state) {
    struct buffer *first = NULL;
    for (uint32_t i = 0; i < buffer_count; i++) {
        if (buffers[i].state == state && (!first || buffers[i].order < first->order)) {
            first = &buffers[i];
        }
    }
    return first;
}

/* Does what the webcam has done since the last call: it exposes, reads out and fills the first buffer that waits. It loses the picture
 * if none does. */
static void advance(void) {
    while (streaming && !is_set("SIMULATED_WEBCAM_LACKS", "pictures")) {
        int64_t period = SECOND_US / interval_denominator, exposed = (int64_t)exposure->value * 100;
        if (exposure_auto->value != V4L2_EXPOSURE_MANUAL) {
            /* It is dark: the longest exposure that may be. */
            period *= dynamic_rate->value ? 2 : 1;
            exposed = period;
        }
        exposed = exposed < period ? exposed : period;
        int64_t begun = started_us + frame * period, end = begun + exposed + period / 2;
        if (end > now_us()) return;
        struct buffer *buffer = first_buffer(QUEUED);
        if (buffer) {
            const char *picture = sizes[size].pictures[frame % (uint32_t)sizes[size].count];
            int by_start = is_set("SIMULATED_WEBCAM_STAMPS", "start");
            buffer->bytes = fill((uint32_t)(buffer - buffers), picture);
            buffer->stamp_us = by_start ? begun : end;
            buffer->flags = V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC
                | (by_start ? V4L2_BUF_FLAG_TSTAMP_SRC_SOE : V4L2_BUF_FLAG_TSTAMP_SRC_EOF)
                | (strstr(picture, "damaged") ? V4L2_BUF_FLAG_ERROR : 0u);
            buffer->sequence = frame;
            buffer->state = DONE;
            buffer->order = order++;
            write_log("frame %s %lld\n", picture, (long long)(begun + exposed / 2));
        }
        frame++;
    }
}

/* Requests. Each returns 0 or the error. */

static int query_capabilities(struct v4l2_capability *to) {
    int is_metadata = is_set("SIMULATED_WEBCAM_LACKS", "capture");
    *to = (struct v4l2_capability){ .driver = "uvcvideo", .card = "Simulated Webcam", .bus_info = "usb-0000:00:14.0-1" };
    to->device_caps = V4L2_CAP_STREAMING | (is_metadata ? V4L2_CAP_META_CAPTURE : V4L2_CAP_VIDEO_CAPTURE);
    /* Of all device files of the webcam. */
    to->capabilities = V4L2_CAP_STREAMING | V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_META_CAPTURE | V4L2_CAP_DEVICE_CAPS;
    return 0;
}

static int get_format(struct v4l2_format *to) {
    memset(&to->fmt, 0, sizeof to->fmt);
    struct v4l2_pix_format *pix = &to->fmt.pix;
    pix->width = sizes[size].width;
    pix->height = sizes[size].height;
    pix->pixelformat = pixel_format;
    pix->field = V4L2_FIELD_NONE;
    pix->bytesperline = pixel_format == V4L2_PIX_FMT_MJPEG ? 0 : bytes_per_line;
    pix->sizeimage = bytes_per_image;
    pix->colorspace = V4L2_COLORSPACE_SRGB;
    return 0;
}

/* Lines of a multiple of 256 bytes, images of whole pages. */
static void choose_size(int chosen) {
    size = chosen;
    bytes_per_line = (2 * sizes[size].width + 255) / 256 * 256;
    bytes_per_image = (bytes_per_line * sizes[size].height + 4095) / 4096 * 4096;
}

/* A format that it has not becomes its own one, a size the one with the fewest pixels outside the common rectangle. */
static int set_format(struct v4l2_format *to) {
    if (buffer_count > 0) return EBUSY;
    uint64_t width = to->fmt.pix.width, height = to->fmt.pix.height, least = UINT64_MAX;
    for (int i = 0; i < size_count; i++) {
        uint64_t own_width = sizes[i].width, own_height = sizes[i].height;
        uint64_t common = (width < own_width ? width : own_width) * (height < own_height ? height : own_height);
        uint64_t outside = width * height + own_width * own_height - 2 * common;
        if (outside < least) {
            least = outside;
            choose_size(i);
        }
    }
    interval_denominator = 30;
    write_log("format %ux%u\n", sizes[size].width, sizes[size].height);
    return get_format(to);
}

static int get_interval(struct v4l2_streamparm *to) {
    memset(&to->parm, 0, sizeof to->parm);
    to->parm.capture.capability = V4L2_CAP_TIMEPERFRAME;
    to->parm.capture.timeperframe = (struct v4l2_fract){ 1, interval_denominator };
    return 0;
}

/* The slowest rate that is as fast as asked for, or the fastest. */
static int set_interval(struct v4l2_streamparm *to) {
    static const uint32_t rates[] = { 30, 20, 15, 10, 5 };
    if (streaming) return EBUSY;
    struct v4l2_fract asked = to->parm.capture.timeperframe;
    for (size_t i = 0; i < sizeof rates / sizeof *rates; i++) {
        if (i == 0 || rates[i] * asked.numerator >= asked.denominator) {
            interval_denominator = rates[i];
        }
    }
    write_log("interval 1/%u\n", interval_denominator);
    return get_interval(to);
}

static struct control *find_control(uint32_t id) {
    for (int i = 0; i < CONTROLS; i++) {
        int is_missing = controls[i].id != V4L2_CID_GAIN && is_set("SIMULATED_WEBCAM_LACKS", "exposure");
        if (controls[i].id == id && !is_missing) return &controls[i];
    }
    return NULL;
}

static int query_control(struct v4l2_query_ext_ctrl *to) {
    struct control *found = find_control(to->id);
    if (!found) return EINVAL;
    *to = (struct v4l2_query_ext_ctrl){ .id = found->id, .type = found->type, .minimum = found->minimum, .maximum = found->maximum,
        .step = (uint64_t)found->step, .default_value = found->value, .elem_size = sizeof found->value, .elems = 1 };
    snprintf(to->name, sizeof to->name, "%s", found->name);
    return 0;
}

static int set_control(struct control *control, int32_t value) {
    int is_menu = control->type == V4L2_CTRL_TYPE_MENU;
    if (is_menu && (value < control->minimum || value > control->maximum)) return ERANGE;
    if (is_menu && value != V4L2_EXPOSURE_MANUAL && value != V4L2_EXPOSURE_APERTURE_PRIORITY) return EINVAL;
    /* The automatic exposure goes on with both of them. */
    if ((control == exposure || control == gain) && exposure_auto->value != V4L2_EXPOSURE_MANUAL) {
        write_log("ignored %s\n", control->name);
        return 0;
    }
    value = value < control->minimum ? control->minimum : value > control->maximum ? control->maximum : value;
    value = control->minimum + (value - control->minimum + control->step / 2) / control->step * control->step;
    control->value = value;
    write_log("control %s %d\n", control->name, value);
    return 0;
}

enum direction { GET, SET };

static int exchange_controls(struct v4l2_ext_controls *list, enum direction direction) {
    for (uint32_t i = 0; i < list->count; i++) {
        struct v4l2_ext_control *entry = &list->controls[i];
        struct control *control = find_control(entry->id);
        int is_of_class = list->which == V4L2_CTRL_WHICH_CUR_VAL || V4L2_CTRL_ID2WHICH(entry->id) == list->which;
        if (!control || !is_of_class) {
            list->error_idx = list->count;
            return EINVAL;
        }
    }
    for (uint32_t i = 0; i < list->count; i++) {
        struct v4l2_ext_control *entry = &list->controls[i];
        struct control *control = find_control(entry->id);
        int error = direction == SET ? set_control(control, entry->value) : 0;
        entry->value = control->value;
        if (error) {
            list->error_idx = i;
            return error;
        }
    }
    return 0;
}

static void stop_stream(void) {
    streaming = 0;
    for (uint32_t i = 0; i < buffer_count; i++) {
        buffers[i].state = DEQUEUED;
    }
}

static int request_buffers(int fd, struct v4l2_requestbuffers *to) {
    if (streaming) return EBUSY;
    buffer_count = to->count < MAX_BUFFERS ? to->count : MAX_BUFFERS;
    memset(buffers, 0, sizeof buffers);
    if (ftruncate(fd, (off_t)bytes_per_image * buffer_count) != 0) return ENOMEM;
    if (buffer_count == 0) {
        owner = -1;
    }
    to->count = buffer_count;
    to->capabilities = V4L2_BUF_CAP_SUPPORTS_MMAP;
    return 0;
}

static void describe_buffer(struct v4l2_buffer *to) {
    const struct buffer *from = &buffers[to->index];
    static const uint32_t state_flags[] = { 0, V4L2_BUF_FLAG_QUEUED, V4L2_BUF_FLAG_DONE };
    to->flags = V4L2_BUF_FLAG_MAPPED | from->flags | state_flags[from->state];
    to->bytesused = from->bytes;
    to->field = V4L2_FIELD_NONE;
    to->timestamp.tv_sec = from->stamp_us / SECOND_US;
    to->timestamp.tv_usec = from->stamp_us % SECOND_US;
    to->sequence = from->sequence;
    to->length = bytes_per_image;
    to->m.offset = to->index * bytes_per_image;
}

static int query_buffer(struct v4l2_buffer *to) {
    if (to->index >= buffer_count) return EINVAL;
    describe_buffer(to);
    return 0;
}

static int queue_buffer(struct v4l2_buffer *to) {
    if (to->index >= buffer_count || buffers[to->index].state != DEQUEUED) return EINVAL;
    buffers[to->index] = (struct buffer){ .state = QUEUED, .order = order++ };
    describe_buffer(to);
    return 0;
}

static int dequeue_buffer(struct v4l2_buffer *to) {
    struct buffer *done = first_buffer(DONE);
    if (!streaming || !done) return streaming ? EAGAIN : EINVAL;
    to->index = (uint32_t)(done - buffers);
    done->state = DEQUEUED;
    describe_buffer(to);
    return 0;
}

static int start_stream(void) {
    const char *error = getenv("SIMULATED_WEBCAM_BUS_ERROR");
    if (buffer_count == 0 || error) return error ? atoi(error) : EINVAL;
    if (!streaming) {
        streaming = 1;
        frame = 0;
        started_us = now_us();
    }
    return 0;
}

/* The kind of buffers that a request is about; 0 if it is about none. */
static uint32_t buffer_type(unsigned long request, const void *value) {
    switch (request) {
    case VIDIOC_G_FMT:
    case VIDIOC_S_FMT:
    case VIDIOC_G_PARM:
    case VIDIOC_S_PARM:
    case VIDIOC_STREAMON:
    case VIDIOC_STREAMOFF: return *(const uint32_t *)value;
    case VIDIOC_REQBUFS: return ((const struct v4l2_requestbuffers *)value)->type;
    case VIDIOC_QUERYBUF:
    case VIDIOC_QBUF:
    case VIDIOC_DQBUF: return ((const struct v4l2_buffer *)value)->type;
    default: return 0;
    }
}

static int answer(int fd, unsigned long request, void *value) {
    uint32_t type = buffer_type(request, value);
    int is_metadata = is_set("SIMULATED_WEBCAM_LACKS", "capture");
    if (type != 0 && (type != V4L2_BUF_TYPE_VIDEO_CAPTURE || is_metadata)) return EINVAL;
    int is_claim = request == VIDIOC_S_FMT || request == VIDIOC_S_PARM || request == VIDIOC_REQBUFS;
    int is_free = request == VIDIOC_G_FMT || request == VIDIOC_G_PARM;
    if (owner == -1 && is_claim) {
        owner = fd;
    }
    if (type != 0 && !is_free && owner != fd) return EBUSY;
    if (is_set("SIMULATED_WEBCAM_LACKS", "interval") && (request == VIDIOC_G_PARM || request == VIDIOC_S_PARM)) return ENOTTY;
    advance();
    switch (request) {
    case VIDIOC_QUERYCAP: return query_capabilities(value);
    case VIDIOC_G_FMT: return get_format(value);
    case VIDIOC_S_FMT: return set_format(value);
    case VIDIOC_G_PARM: return get_interval(value);
    case VIDIOC_S_PARM: return set_interval(value);
    case VIDIOC_QUERY_EXT_CTRL: return query_control(value);
    case VIDIOC_G_EXT_CTRLS: return exchange_controls(value, GET);
    case VIDIOC_S_EXT_CTRLS: return exchange_controls(value, SET);
    case VIDIOC_REQBUFS: return request_buffers(fd, value);
    case VIDIOC_QUERYBUF: return query_buffer(value);
    case VIDIOC_QBUF: return queue_buffer(value);
    case VIDIOC_DQBUF: return dequeue_buffer(value);
    case VIDIOC_STREAMON: return start_stream();
    case VIDIOC_STREAMOFF: stop_stream(); return 0;
    default: return ENOTTY;
    }
}

static long control_webcam(struct handle *handle, unsigned long request, void *value) {
    pthread_mutex_lock(&lock);
    int error = is_unplugged(handle) ? ENODEV : answer(handle->fd, request, value);
    pthread_mutex_unlock(&lock);
    errno = error;
    return error ? -1 : 0;
}

/* What an open file has to tell: one that is unplugged and one that does not stream are in error. */
static short events_of(struct handle *handle) {
    pthread_mutex_lock(&lock);
    short events = POLLERR | POLLHUP;
    if (!is_unplugged(handle)) {
        advance();
        events = owner != handle->fd || !streaming ? POLLERR : first_buffer(DONE) ? POLLIN | POLLRDNORM : 0;
    }
    pthread_mutex_unlock(&lock);
    return events;
}

/* A file in memory stands for the device: what is mapped of it are the buffers. */
static int open_webcam(void) {
    struct stat plug;
    if (stat(in_folder("plugged"), &plug) != 0) {
        errno = ENOENT;
        return -1;
    }
    pthread_mutex_lock(&lock);
    if (size_count == 0) {
        read_sizes();
        choose_size(0);
    }
    int fd = memfd_create("simulated webcam", MFD_CLOEXEC);
    struct handle *handle = find_handle(0);
    if (fd <= 0 || size_count == 0 || !handle) abort();
    *handle = (struct handle){ fd, plug };
    pthread_mutex_unlock(&lock);
    return fd;
}

static void close_webcam(struct handle *handle) {
    if (owner == handle->fd) {
        stop_stream();
        buffer_count = 0;
        owner = -1;
    }
    handle->fd = 0;
}

/* In place of the C library's functions. */

#define NEXT(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

static mode_t mode_of(int flags, va_list values) {
    return flags & (O_CREAT | O_TMPFILE) ? va_arg(values, mode_t) : 0;
}

#define OPEN(name) \
    int name(const char *path, int flags, ...) { \
        va_list values; \
        va_start(values, flags); \
        mode_t mode = mode_of(flags, values); \
        va_end(values); \
        return is_webcam(path) ? open_webcam() : NEXT(name)(path, flags, mode); \
    }
OPEN(open)
OPEN(open64)

int close(int fd) {
    pthread_mutex_lock(&lock);
    struct handle *handle = fd > 0 ? find_handle(fd) : NULL;
    if (handle) {
        close_webcam(handle);
    }
    pthread_mutex_unlock(&lock);
    return NEXT(close)(fd);
}

int statx(int folder, const char *restrict path, int flags, unsigned mask, struct statx *restrict to) {
    struct stat plug;
    if (!is_webcam(path)) return NEXT(statx)(folder, path, flags, mask, to);
    if (stat(in_folder("plugged"), &plug) != 0) {
        errno = ENOENT;
        return -1;
    }
    memset(to, 0, sizeof *to);
    to->stx_mask = STATX_BASIC_STATS;
    to->stx_mode = S_IFCHR | 0660;
    to->stx_rdev_major = VIDEO_MAJOR;
    return 0;
}

int poll(struct pollfd *files, nfds_t count, int timeout) {
    struct handle *handle = count == 1 && files[0].fd > 0 ? find_handle(files[0].fd) : NULL;
    if (!handle) return NEXT(poll)(files, count, timeout);
    int is_silent = is_set("SIMULATED_WEBCAM_LACKS", "pictures");
    int64_t end = now_us() + (is_silent ? 0 : (int64_t)timeout * 1000);
    for (;;) {
        files[0].revents = (short)(events_of(handle) & (files[0].events | POLLERR | POLLHUP));
        if (files[0].revents || (timeout >= 0 && now_us() >= end)) return files[0].revents != 0;
        usleep(1000);
    }
}

/* The crate under the program asks the system itself, not by ioctl(). */
long syscall(long number, ...) {
    long given[6];
    va_list values;
    va_start(values, number);
    for (int i = 0; i < 6; i++) {
        given[i] = va_arg(values, long);
    }
    va_end(values);
    static __typeof__(&syscall) next;
    if (!next) {
        next = NEXT(syscall);
    }
    struct handle *handle = number == SYS_ioctl && given[0] > 0 ? find_handle((int)given[0]) : NULL;
    if (handle) return control_webcam(handle, (unsigned long)given[1], (void *)given[2]);
    return next(number, given[0], given[1], given[2], given[3], given[4], given[5]);
}

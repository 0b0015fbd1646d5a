// SPDX-License-Identifier: MIT
// omnibot-sil: the firmware as a process on a SocketCAN interface.
#define _DEFAULT_SOURCE
#include "app.h"
#include "histogram.h"
#include "messages.h"
#include "settings_file.h"
#include "socketcan.h"
#include "timer.h"

#include <errno.h>
#include <getopt.h>
#include <poll.h>
#include <sched.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>

enum { REALTIME_PRIORITY = 50 };

static const char usage[] =
    "usage: omnibot-sil --can INTERFACE [--node N] [--time lockstep|realtime] [--timing FILE]\n"
    "                   [--parameters FILE]\n"
    "  --can INTERFACE  SocketCAN interface, such as vcan0\n"
    "  --node N         our node on the bus, 0 to 15 (default 0)\n"
    "  --time WHAT      lockstep: a step when the host says so (default); realtime: by our own timer as well,\n"
    "                   where the host asks for it, SCHED_FIFO and locked memory where they are permitted\n"
    "  --timing FILE    with realtime: at the end, histograms of step time and release jitter as JSON\n"
    "  --parameters FILE  keeps the parameters over a restart; the file is made when there is none (default: nothing "
    "is\n"
    "                   kept)\n";

typedef struct {
    const char *interface;
    const char *timing_file;     // NULL: none
    const char *parameters_file; // NULL: none
    uint8_t node;
    bool realtime;
} options_t;

typedef struct {
    app_t app;
    int socket;
    period_timer_t timer; // handle −1 in lockstep
    settings_file_t settings;
    histogram_t step_time;
    histogram_t release_jitter;
    uint64_t overruns;
} process_t;

static volatile sig_atomic_t stopping;

static void stop(int signal_number)
{
    (void)signal_number;
    stopping = 1;
}

/// Ends the wait for a frame on Ctrl-C and on a polite kill.
static void stop_on_signals(void)
{
    struct sigaction action = {.sa_handler = stop};
    sigaction(SIGINT, &action, NULL);
    sigaction(SIGTERM, &action, NULL);
}

// ---- command line

static bool parse_node(const char *text, uint8_t *node)
{
    char *end;
    const unsigned long value = strtoul(text, &end, 10);
    if (end == text || *end != '\0' || text[0] == '-' || value >= FRAME_NODE_COUNT) {
        fprintf(stderr, "omnibot-sil: --node %s: must be a whole number from 0 to %d\n", text, FRAME_NODE_COUNT - 1);
        return false;
    }
    *node = (uint8_t)value;
    return true;
}

static bool parse_time(const char *text, bool *realtime)
{
    *realtime = strcmp(text, "realtime") == 0;
    if (!*realtime && strcmp(text, "lockstep") != 0) {
        fprintf(stderr, "omnibot-sil: --time %s: must be lockstep or realtime\n", text);
        return false;
    }
    return true;
}

static bool parse_option(int option, options_t *options)
{
    switch (option) {
    case 'h':
        fputs(usage, stdout);
        exit(EXIT_SUCCESS);
    case 'c':
        options->interface = optarg;
        return true;
    case 'n':
        return parse_node(optarg, &options->node);
    case 't':
        return parse_time(optarg, &options->realtime);
    case 'f':
        options->timing_file = optarg;
        return true;
    case 'p':
        options->parameters_file = optarg;
        return true;
    default:
        return false;
    }
}

static bool parse_options(int argc, char **argv, options_t *options)
{
    static const struct option known[] = {{"can", required_argument, NULL, 'c'},
                                          {"node", required_argument, NULL, 'n'},
                                          {"time", required_argument, NULL, 't'},
                                          {"timing", required_argument, NULL, 'f'},
                                          {"parameters", required_argument, NULL, 'p'},
                                          {"help", no_argument, NULL, 'h'},
                                          {0}};
    int option;
    while ((option = getopt_long(argc, argv, "", known, NULL)) != -1) {
        if (!parse_option(option, options)) {
            return false;
        }
    }
    if (options->interface == NULL || optind != argc) {
        fputs(usage, stderr);
        return false;
    }
    if (options->timing_file != NULL && !options->realtime) {
        fputs("omnibot-sil: --timing FILE: there is nothing to time in lockstep; add --time realtime\n", stderr);
        return false;
    }
    return true;
}

// ---- the bus and the timer

static bool send_all(process_t *process)
{
    frame_t frame;
    while (app_transmit(&process->app, &frame)) {
        if (!socketcan_send(process->socket, &frame)) {
            return false;
        }
    }
    return true;
}

static bool serve_frame(process_t *process)
{
    frame_t frame;
    const socketcan_result_t result = socketcan_receive(process->socket, &frame);
    if (result == SOCKETCAN_FAILED) {
        return false;
    }
    if (result == SOCKETCAN_FRAME) {
        if (process->timer.handle >= 0) { // in lockstep the same run gives the same bytes
            app_stir(&process->app, (uint32_t)timer_now_ns());
        }
        app_receive(&process->app, &frame);
    }
    return send_all(process);
}

/// One step if a period has ended: the newest one, with those before it counted as overruns. The answers are on the bus
/// before the step's time is taken, as on a board.
static bool serve_timer(process_t *process)
{
    uint64_t late_ns = 0;
    const uint64_t periods = timer_expired(&process->timer, &late_ns);
    if (periods == 0 || process->app.port.drive == DRIVE_LOCKSTEP) {
        return true;
    }
    const uint64_t begin_ns = timer_now_ns();
    if (periods > 1) {
        process->overruns += periods - 1;
        app_note_overrun(&process->app, (uint32_t)(periods - 1));
    }
    app_tick(&process->app);
    const bool sent = send_all(process);
    const uint64_t step_ns = timer_now_ns() - begin_ns;
    app_note_step_time(&process->app, step_ns < UINT32_MAX ? (uint32_t)step_ns : UINT32_MAX);
    histogram_add(&process->step_time, step_ns);
    histogram_add(&process->release_jitter, late_ns);
    return sent;
}

/// Waits for a frame or the end of a period; the timer goes first, and frames that wait are taken before the next look
/// at the clock.
static bool serve_once(process_t *process)
{
    struct pollfd wanted[2] = {{.fd = process->socket, .events = POLLIN},
                               {.fd = process->timer.handle, .events = POLLIN}};
    if (poll(wanted, 2, 200) < 0) {
        return errno == EINTR;
    }
    if ((wanted[1].revents & POLLIN) != 0 && !serve_timer(process)) {
        return false;
    }
    return wanted[0].revents == 0 || serve_frame(process);
}

/// Serves the bus until a signal ends it (true) or the bus fails (false).
static bool serve(process_t *process)
{
    while (!stopping) {
        const bool alive = process->timer.handle < 0 ? serve_frame(process) : serve_once(process);
        if (!alive) {
            return false;
        }
    }
    return true;
}

// ---- real time

/// Asks for what keeps others from delaying us, and says what was not granted.
static void ask_for_realtime(void)
{
    const struct sched_param priority = {.sched_priority = REALTIME_PRIORITY};
    if (sched_setscheduler(0, SCHED_FIFO, &priority) != 0) {
        fprintf(stderr, "omnibot-sil: no SCHED_FIFO (%s): other programs may delay the tick\n", strerror(errno));
    }
    if (mlockall(MCL_CURRENT | MCL_FUTURE) != 0) {
        fprintf(stderr, "omnibot-sil: memory is not locked (%s): a page fault may delay the tick\n", strerror(errno));
    }
}

static bool start_timer(process_t *process)
{
    ask_for_realtime();
    process->timer = timer_start(omnibot.control_period_us);
    if (process->timer.handle < 0) {
        fprintf(stderr, "omnibot-sil: no timer: %s\n", strerror(errno));
        return false;
    }
    return true;
}

static bool write_timing(const process_t *process, const char *name)
{
    FILE *file = fopen(name, "w");
    if (file == NULL) {
        fprintf(stderr, "omnibot-sil: cannot write %s: %s\n", name, strerror(errno));
        return false;
    }
    fputs("{\"step_time\": ", file);
    histogram_write(&process->step_time, file);
    fputs(",\n \"release_jitter\": ", file);
    histogram_write(&process->release_jitter, file);
    fprintf(file, ",\n \"overruns\": %llu}\n", (unsigned long long)process->overruns);
    const bool failed = ferror(file) != 0;
    if (fclose(file) != 0 || failed) {
        fprintf(stderr, "omnibot-sil: cannot write %s: %s\n", name, strerror(errno));
        return false;
    }
    return true;
}

static app_port_t port_of(const options_t *options)
{
    const uint8_t lockstep = 1u << DRIVE_LOCKSTEP, realtime = 1u << DRIVE_REALTIME;
    return (app_port_t){
        .drives = options->realtime ? lockstep | realtime : lockstep,
        .drive = options->realtime ? DRIVE_REALTIME : DRIVE_LOCKSTEP,
    };
}

int main(int argc, char **argv)
{
    static process_t process = {.timer = {.handle = -1}, .settings = {.handle = -1}};
    options_t options = {.interface = NULL};
    if (!parse_options(argc, argv, &options)) {
        return 2;
    }
    if (options.parameters_file != NULL && !settings_file_open(&process.settings, options.parameters_file)) {
        return 1;
    }
    process.socket = socketcan_open(options.interface, options.node);
    if (process.socket < 0) {
        fprintf(stderr,
                "omnibot-sil: cannot open %s: %s; is it there and up? tools/with-vcan -- COMMAND makes a vcan0\n",
                options.interface, strerror(errno));
        return 1;
    }
    stop_on_signals();
    app_init(&process.app, &omnibot, options.node, port_of(&options));
    if (options.parameters_file != NULL) {
        app_use_settings(&process.app, &process.settings.memory);
    }
    if (options.realtime && !start_timer(&process)) {
        return 1;
    }
    fprintf(stderr, "omnibot-sil: node %d on %s, %s\n", options.node, options.interface,
            options.realtime ? "in real time" : "in lockstep");
    if (!serve(&process)) {
        fprintf(stderr, "omnibot-sil: %s failed: %s\n", options.interface, strerror(errno));
        return 1;
    }
    return options.timing_file == NULL || write_timing(&process, options.timing_file) ? 0 : 1;
}

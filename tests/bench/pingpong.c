// SPDX-License-Identifier: MIT
// omnibot-pingpong INTERFACE NODE TICKS: the least that a lockstep tick costs on a SocketCAN interface. Two processes
// pass the frames of so many ticks to and fro and compute nothing; prints the nanoseconds of a tick.
#define _DEFAULT_SOURCE
#include "messages.h"
#include "socketcan.h"

#include <errno.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

enum { WARM_UP_TICKS = 100, STATUS_EVERY_TICKS = 100, SILENCES_MAX = 10, NS_PER_S = 1000000000 };

typedef struct {
    const char *interface;
    uint8_t node;
    uint32_t ticks;
} options_t;

static bool is(const frame_t *frame, int function)
{
    return frame->id >> FRAME_NODE_BITS == function;
}

/// Answers every SYNC with the frames of the firmware, until it is killed.
static void echo(int socket, uint8_t node)
{
    frame_t frame, torque, slip, status;
    sync_message_t sync;
    torque_encode(&torque, node, &(torque_message_t){0});
    slip_encode(&slip, node, &(slip_message_t){0});
    status_encode(&status, node, &(status_message_t){0});
    socketcan_result_t result;
    while ((result = socketcan_receive(socket, &frame)) != SOCKETCAN_FAILED) {
        if (result == SOCKETCAN_FRAME && is(&frame, SYNC_FUNCTION) && sync_decode(&sync, &frame) == DECODE_OK) {
            (void)socketcan_send(socket, &torque);
            (void)socketcan_send(socket, &slip);
            if (sync.tick % STATUS_EVERY_TICKS == 0) {
                (void)socketcan_send(socket, &status);
            }
        }
    }
}

static bool wait_for_answers(int socket)
{
    bool torque = false, slip = false;
    int silences = 0;
    while (!torque || !slip) {
        frame_t frame;
        const socketcan_result_t result = socketcan_receive(socket, &frame);
        if (result == SOCKETCAN_FAILED || (result == SOCKETCAN_NOTHING && ++silences > SILENCES_MAX)) {
            return false;
        }
        torque |= result == SOCKETCAN_FRAME && is(&frame, TORQUE_FUNCTION);
        slip |= result == SOCKETCAN_FRAME && is(&frame, SLIP_FUNCTION);
    }
    return true;
}

/// The host's side of some ticks.
static bool ask(int socket, uint8_t node, uint32_t ticks)
{
    frame_t pose, speed, sync;
    pose_encode(&pose, node, &(pose_message_t){0});
    wheel_speed_encode(&speed, node, &(wheel_speed_message_t){0});
    for (uint32_t tick = 0; tick < ticks; tick++) {
        sync_encode(&sync, node, &(sync_message_t){.tick = tick});
        if (!socketcan_send(socket, &pose) || !socketcan_send(socket, &speed) || !socketcan_send(socket, &sync) ||
            !wait_for_answers(socket)) {
            return false;
        }
    }
    return true;
}

static int64_t now_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * NS_PER_S + now.tv_nsec;
}

static bool parse(const char *text, unsigned long max, unsigned long *value)
{
    char *end;
    *value = strtoul(text, &end, 10);
    return end != text && *end == '\0' && text[0] != '-' && *value <= max;
}

static bool parse_options(int argc, char **argv, options_t *options)
{
    unsigned long node, ticks;
    if (argc != 4 || !parse(argv[2], FRAME_NODE_COUNT - 1, &node) || !parse(argv[3], UINT32_MAX, &ticks) ||
        ticks == 0) {
        return false;
    }
    *options = (options_t){argv[1], (uint8_t)node, (uint32_t)ticks};
    return true;
}

int main(int argc, char **argv)
{
    options_t options;
    if (!parse_options(argc, argv, &options)) {
        fprintf(stderr, "usage: omnibot-pingpong INTERFACE NODE TICKS, a node of 0 to %d\n", FRAME_NODE_COUNT - 1);
        return 2;
    }
    // Both are open before either process runs: no frame is lost to a late start.
    const int here = socketcan_open(options.interface, options.node);
    const int there = socketcan_open(options.interface, options.node);
    if (here < 0 || there < 0) {
        fprintf(stderr, "omnibot-pingpong: cannot open %s: %s\n", options.interface, strerror(errno));
        return 1;
    }
    const pid_t child = fork();
    if (child == 0) {
        echo(there, options.node);
        return 1;
    }
    bool done = child > 0 && ask(here, options.node, WARM_UP_TICKS);
    const int64_t begin_ns = now_ns();
    done = done && ask(here, options.node, options.ticks);
    const int64_t total_ns = now_ns() - begin_ns;
    if (child > 0) {
        kill(child, SIGKILL);
        waitpid(child, NULL, 0);
    }
    if (!done) {
        fprintf(stderr, "omnibot-pingpong: no answer on %s\n", options.interface);
        return 1;
    }
    printf("%lld\n", (long long)(total_ns / options.ticks));
    return 0;
}

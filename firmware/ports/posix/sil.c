// SPDX-License-Identifier: MIT
// omnibot-sil: the firmware as a process on a SocketCAN interface.
#define _DEFAULT_SOURCE
#include "app.h"
#include "messages.h"
#include "socketcan.h"

#include <errno.h>
#include <getopt.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char usage[] = "usage: omnibot-sil --can INTERFACE [--node N]\n"
                            "  --can INTERFACE  SocketCAN interface, such as vcan0\n"
                            "  --node N         our node on the bus, 0 to 15 (default 0)\n";

typedef struct {
    const char *interface;
    uint8_t node;
} options_t;

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

static bool parse_options(int argc, char **argv, options_t *options)
{
    static const struct option known[] = {{"can", required_argument, NULL, 'c'},
                                          {"node", required_argument, NULL, 'n'},
                                          {"help", no_argument, NULL, 'h'},
                                          {0}};
    int option;
    while ((option = getopt_long(argc, argv, "", known, NULL)) != -1) {
        if (option == 'h') {
            fputs(usage, stdout);
            exit(EXIT_SUCCESS);
        }
        if (option == 'c') {
            options->interface = optarg;
        } else if (option != 'n' || !parse_node(optarg, &options->node)) {
            return false;
        }
    }
    if (options->interface == NULL || optind != argc) {
        fputs(usage, stderr);
        return false;
    }
    return true;
}

static bool send_all(app_t *app, int socket)
{
    frame_t frame;
    while (app_transmit(app, &frame)) {
        if (!socketcan_send(socket, &frame)) {
            return false;
        }
    }
    return true;
}

/// Serves the bus until a signal ends it (true) or the bus fails (false).
static bool serve(app_t *app, int socket)
{
    while (!stopping) {
        frame_t frame;
        const socketcan_result_t result = socketcan_receive(socket, &frame);
        if (result == SOCKETCAN_FAILED) {
            return false;
        }
        if (result == SOCKETCAN_FRAME) {
            app_receive(app, &frame);
            if (!send_all(app, socket)) {
                return false;
            }
        }
    }
    return true;
}

int main(int argc, char **argv)
{
    app_t app;
    options_t options = {.interface = NULL, .node = 0};
    if (!parse_options(argc, argv, &options)) {
        return 2;
    }
    const int socket = socketcan_open(options.interface, options.node);
    if (socket < 0) {
        fprintf(stderr,
                "omnibot-sil: cannot open %s: %s; is it there and up? tools/with-vcan -- COMMAND makes a vcan0\n",
                options.interface, strerror(errno));
        return 1;
    }
    stop_on_signals();
    app_init(&app, &omnibot, options.node, (app_port_t){.drives = 1u << DRIVE_LOCKSTEP, .drive = DRIVE_LOCKSTEP});
    fprintf(stderr, "omnibot-sil: node %d on %s\n", options.node, options.interface);
    if (!serve(&app, socket)) {
        fprintf(stderr, "omnibot-sil: %s failed: %s\n", options.interface, strerror(errno));
        return 1;
    }
    return 0;
}

// SPDX-License-Identifier: MIT
#define _DEFAULT_SOURCE
#include "socketcan.h"

#include <errno.h>
#include <linux/can.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <poll.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <unistd.h>

enum { SEND_ATTEMPTS = 100, SEND_WAIT_MS = 10 };

/// Only the frames of our node, with 11-bit identifiers and data.
static bool keep_node(int socket, uint8_t node)
{
    const struct can_filter filter = {
        .can_id = node,
        .can_mask = FRAME_NODE_MASK | CAN_EFF_FLAG | CAN_RTR_FLAG,
    };
    return setsockopt(socket, SOL_CAN_RAW, CAN_RAW_FILTER, &filter, sizeof filter) == 0;
}

/// A read returns now and then, so that a signal that came just before it is noticed.
static bool limit_wait(int socket)
{
    const struct timeval limit = {.tv_sec = 0, .tv_usec = 200000};
    return setsockopt(socket, SOL_SOCKET, SO_RCVTIMEO, &limit, sizeof limit) == 0;
}

static bool bind_to(int socket, const char *interface)
{
    const unsigned index = if_nametoindex(interface);
    if (index == 0) {
        return false;
    }
    const struct sockaddr_can address = {.can_family = AF_CAN, .can_ifindex = (int)index};
    return bind(socket, (const struct sockaddr *)&address, sizeof address) == 0;
}

int socketcan_open(const char *interface, uint8_t node)
{
    const int handle = socket(PF_CAN, SOCK_RAW | SOCK_CLOEXEC, CAN_RAW);
    if (handle < 0) {
        return -1;
    }
    if (!keep_node(handle, node) || !limit_wait(handle) || !bind_to(handle, interface)) {
        const int reason = errno;
        close(handle);
        errno = reason;
        return -1;
    }
    return handle;
}

socketcan_result_t socketcan_receive(int socket, frame_t *frame)
{
    struct can_frame raw;
    const ssize_t size = read(socket, &raw, sizeof raw);
    if (size < 0) {
        return errno == EINTR || errno == EAGAIN ? SOCKETCAN_NOTHING : SOCKETCAN_FAILED;
    }
    if (size != (ssize_t)sizeof raw || raw.len > FRAME_DATA_BYTES) {
        return SOCKETCAN_NOTHING;
    }
    frame->id = (uint16_t)(raw.can_id & CAN_SFF_MASK);
    frame->length = raw.len;
    memcpy(frame->data, raw.data, FRAME_DATA_BYTES);
    return SOCKETCAN_FRAME;
}

bool socketcan_send(int socket, const frame_t *frame)
{
    struct can_frame raw = {.can_id = frame->id, .len = frame->length};
    memcpy(raw.data, frame->data, FRAME_DATA_BYTES);
    // A full queue is not an error of ours: wait for room, but not for ever.
    for (int attempt = 0; attempt < SEND_ATTEMPTS; attempt++) {
        if (write(socket, &raw, sizeof raw) == (ssize_t)sizeof raw) {
            return true;
        }
        if (errno != ENOBUFS && errno != EAGAIN && errno != EINTR) {
            return false;
        }
        struct pollfd room = {.fd = socket, .events = POLLOUT};
        (void)poll(&room, 1, SEND_WAIT_MS);
    }
    errno = ENOBUFS;
    return false;
}

// SPDX-License-Identifier: MIT
// Raw SocketCAN: classic frames with 11-bit identifiers.
#ifndef OMNIBOT_PORTS_POSIX_SOCKETCAN_H
#define OMNIBOT_PORTS_POSIX_SOCKETCAN_H

#include "frame.h"

#include <stdbool.h>

/// Opens an interface for the frames of one node; −1 and errno on failure.
int socketcan_open(const char *interface, uint8_t node);

typedef enum { SOCKETCAN_FRAME, SOCKETCAN_NOTHING, SOCKETCAN_FAILED } socketcan_result_t;

/// Waits for the next frame, at most 0.2 s. SOCKETCAN_NOTHING: none came, or one of a kind we do not speak;
/// SOCKETCAN_FAILED: errno says why.
socketcan_result_t socketcan_receive(int socket, frame_t *frame);

/// Sends a frame, waiting up to a second for room; false and errno on failure.
bool socketcan_send(int socket, const frame_t *frame);

#endif

// SPDX-License-Identifier: MIT
#include "inproc.h"

#include "app.h"
#include "messages.h"

#define EXPORTED __attribute__((visibility("default")))

EXPORTED size_t omnibot_size(void)
{
    return sizeof(app_t);
}

EXPORTED void omnibot_init(void *memory, uint8_t node)
{
    const app_port_t port = {.drives = 1u << DRIVE_LOCKSTEP | 1u << DRIVE_REALTIME, .drive = DRIVE_LOCKSTEP};
    app_init(memory, &omnibot, node, port);
}

EXPORTED void omnibot_receive(void *instance, const frame_t *frame)
{
    app_receive(instance, frame);
}

EXPORTED bool omnibot_transmit(void *instance, frame_t *frame)
{
    return app_transmit(instance, frame);
}

EXPORTED void omnibot_tick(void *instance)
{
    app_tick(instance);
}

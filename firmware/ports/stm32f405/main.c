// SPDX-License-Identifier: MIT
// The robot: frames as they come, a tick a millisecond, all of it in thread mode. The interrupts move bytes and count.
#include "app.h"
#include "board.h"
#include "interrupts.h"
#include "messages.h"

enum { NODE = OMNIBOT_NODE };

static board_t board;
static app_t app;

void usart1_interrupt(void)
{
    usart_interrupt(&board.usart);
}

void systick_interrupt(void)
{
    atomic_fetch_add_explicit(&board.ticks, 1u, memory_order_relaxed);
}

static bool take_frame(void)
{
    frame_t frame;
    if (!link_receive(&board.link, &frame)) {
        return false;
    }
    app_receive(&app, &frame);
    return true;
}

static void send_frames(void)
{
    frame_t frame;
    while (link_has_room(&board.link) && app_transmit(&app, &frame)) {
        link_send(&board.link, &frame);
    }
    link_flush(&board.link);
    board_pump(&board);
}

int main(void)
{
    board_start(&board);
    app_init(&app, &omnibot, NODE, (app_port_t){.drives = 1u << DRIVE_LOCKSTEP, .drive = DRIVE_LOCKSTEP});
    for (;;) {
        (void)board_periods(&board);
        const bool busy = take_frame();
        send_frames();
        if (!busy) {
            board_sleep();
        }
    }
}

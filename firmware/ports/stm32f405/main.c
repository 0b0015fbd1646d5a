// SPDX-License-Identifier: MIT
// The program: one robot, and the interrupts that move its bytes and count its periods.
#include "board_header.h"
#include "interrupts.h"
#include "loop.h"

static loop_t loop;

void usart1_interrupt(void)
{
    usart_interrupt(&loop.board.usart);
}

void can1_rx0_interrupt(void)
{
    can_interrupt(&loop.board.can, 0);
}

void can1_rx1_interrupt(void)
{
    can_interrupt(&loop.board.can, 1);
}

void systick_interrupt(void)
{
    board_count_tick(&loop.board);
}

int main(void)
{
    loop_start(&loop, BOARD_NODE);
    for (;;) {
        loop_turn(&loop);
    }
}

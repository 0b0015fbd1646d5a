// SPDX-License-Identifier: MIT
#include "loop.h"

#include "messages.h"

static bool send_frames(loop_t *loop)
{
    frame_t frame;
    for (uint32_t sent = 0; sent < OUTBOX_FRAMES && link_has_room(&loop->board.link); sent++) {
        if (!app_transmit(&loop->app, &frame)) {
            break;
        }
        link_send(&loop->board.link, &frame);
    }
    const bool waiting = link_flush(&loop->board.link);
    board_pump(&loop->board);
    return waiting;
}

static void note_step_time(loop_t *loop, uint32_t begin)
{
    const cycles_t *cycles = &loop->board.cycles;
    if (cycles->works) {
        app_note_step_time(&loop->app, cycles_to_ns(cycles, cycles_now(cycles) - begin));
    }
}

static bool is_paced_by_timer(const loop_t *loop)
{
    return loop->app.port.drive != DRIVE_LOCKSTEP;
}

// ---- a period

/// By the cycle counter, since the main loop comes to it a little late, not always equally.
static float time_since_measured_s(loop_t *loop, uint32_t periods)
{
    const cycles_t *cycles = &loop->board.cycles;
    const uint32_t now = cycles_now(cycles);
    const uint32_t passed = now - loop->measured_at;
    loop->measured_at = now;
    return cycles->works ? (float)passed / (float)cycles->core_Hz
                         : 1.0e-6f * (float)periods * (float)omnibot.control_period_us;
}

static void drive_wheels(loop_t *loop)
{
    board_t *board = &loop->board;
    const uint8_t fault = board_motor_fault(board);
    if (fault != FAULT_NONE) {
        app_note_motor_fault(&loop->app, fault);
    }
    vec3_t torque_Nm;
    if (app_motor_torque(&loop->app, &torque_Nm)) {
        wheels_drive(&board->wheels, torque_Nm, board->adc.battery_V);
    } else {
        wheels_off(&board->wheels);
    }
}

static void step(loop_t *loop, uint32_t periods)
{
    const uint32_t begin = cycles_now(&loop->board.cycles);
    const float time_s = time_since_measured_s(loop, periods);
    app_set_wheel_speed(&loop->app, wheels_measure(&loop->board.wheels, time_s));
    if (is_paced_by_timer(loop) && periods > 1) {
        app_note_overrun(&loop->app, periods - 1u);
    }
    app_tick(&loop->app);
    drive_wheels(loop);
    if (is_paced_by_timer(loop)) {
        (void)send_frames(loop);
        note_step_time(loop, begin);
    }
}

static bool app_is_in_order(const loop_t *loop)
{
    return loop->app.mode <= MODE_FAULT && loop->app.robot == &omnibot;
}

static void serve_tick(loop_t *loop)
{
    const uint32_t periods = board_periods(&loop->board);
    if (periods == 0) {
        return;
    }
    board_tick(&loop->board);
    step(loop, periods);
    const app_health_t health = board_health(&loop->board);
    app_note_health(&loop->app, &health);
    board_show(&loop->board, loop->app.mode, loop->app.fault);
    board_feed_watchdog(periods, app_is_in_order(loop));
}

// ---- a frame

/// In lockstep a SYNC is the step; its answers are on their way before its time is taken.
static bool serve_frame(loop_t *loop)
{
    frame_t frame;
    if (!link_receive(&loop->board.link, &frame)) {
        return false;
    }
    const uint32_t begin = cycles_now(&loop->board.cycles);
    const bool is_step = !is_paced_by_timer(loop) && frame.id >> FRAME_NODE_BITS == SYNC_FUNCTION;
    app_stir(&loop->app, begin);
    app_receive(&loop->app, &frame);
    if (is_step) {
        (void)send_frames(loop);
        note_step_time(loop, begin);
    }
    return true;
}

// ---- the outside

void loop_start(loop_t *loop, uint8_t node)
{
    static const app_port_t port = {.drives = 1u << DRIVE_LOCKSTEP | 1u << DRIVE_REALTIME | 1u << DRIVE_MOTORS,
                                    .drive = DRIVE_LOCKSTEP};
    board_start(&loop->board, node);
    app_init(&loop->app, &omnibot, node, port);
    const settings_memory_t *settings = board_settings(&loop->board);
    if (settings != NULL) {
        app_use_settings(&loop->app, settings);
    }
    loop->measured_at = cycles_now(&loop->board.cycles);
    if (crash_is_there(&board_crash)) {
        app_note_crash(&loop->app, board_crash.facts.pc, board_crash.facts.lr);
        crash_clear(&board_crash);
    }
}

void loop_turn(loop_t *loop)
{
    serve_tick(loop);
    const bool took = serve_frame(loop);
    const bool waiting = send_frames(loop);
    if (!took && !waiting) {
        board_sleep(&loop->board);
    }
}

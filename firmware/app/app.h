// SPDX-License-Identifier: MIT
// The robot as a state machine on a CAN bus: frames in, frames out, one control step a tick. No globals: an instance is
// an app_t, as many as there is memory for. Pure but for its own state: the port moves the frames and says when a
// period has passed.
#ifndef OMNIBOT_APP_APP_H
#define OMNIBOT_APP_APP_H

#include "braking.h"
#include "control.h"
#include "fault_table.h"
#include "frame.h"
#include "outbox.h"
#include "parameters.h"
#include "reading.h"
#include "settings.h"
#include "store.h"

enum {
    APP_STATUS_EVERY_TICKS = 100,
    APP_HEARTBEAT_TICKS_MAX = 100, // a host that has sent no SYNC for longer is gone
    APP_KEY_TICKS = 5000,          // START must come so soon after ARM
    APP_REQUESTS_LOST_MAX = 2,     // in a row: a counter that is further on is none of a request that follows
    APP_VERSION_MAJOR = 0,
    APP_VERSION_MINOR = 1,
    APP_VERSION_PATCH = 0
};

/// What a port can do. A drive says what paces the robot and what it moves:
/// DRIVE_LOCKSTEP: sensors from the bus, one step a SYNC; DRIVE_REALTIME: sensors from the bus, steps by the port's
/// timer; DRIVE_MOTORS: wheel speeds from the port's encoders, steps by its timer, torque to its bridges.
typedef struct {
    uint8_t drives; // bit mask of 1u << DRIVE_…
    uint8_t drive;  // DRIVE_… to start in
} app_port_t;

/// What a board knows of itself: the fields of HEALTH.
typedef struct {
    uint8_t reset_cause;  // RESET_CAUSE_…
    uint8_t clock_source; // CLOCK_SOURCE_…
    uint8_t can_state;    // CAN_STATE_…
    uint8_t can_tx_errors, can_rx_errors;
    uint8_t can_bus_offs; // how often
    uint8_t can_rx_lost;  // frames
    float supply_V;       // NaN: not measured
} app_health_t;

/// Frames that were not taken, by reason, and those that found no room on their way out; each stops at its largest
/// value.
typedef struct {
    uint16_t damaged;     // wrong length or CRC
    uint16_t replayed;    // repeated, late, or with a counter that does not follow
    uint16_t masqueraded; // under an identifier that is this robot's to send
    uint16_t unsent;
    uint16_t all;
} drops_t;

/// How long the steps took since the last TIMING.
typedef struct {
    uint32_t count;
    uint32_t min_ns, max_ns, sum_ns;
} step_times_t;

typedef struct {
    const robot_t *robot;
    const settings_memory_t *settings; // where parameters outlive a reset; NULL: nowhere
    app_port_t port;
    uint8_t node;
    uint8_t mode;    // MODE_…
    uint8_t fault;   // FAULT_… that came first since the last CLEAR
    uint8_t refusal; // REFUSAL_… of the last COMMAND
    uint16_t fault_mask;
    uint16_t records_owed;             // a bit a fault: their FAULT_RECORD is due
    uint16_t fault_count[FAULT_COUNT]; // since app_init; stops at its largest value
    uint32_t fault_tick[FAULT_COUNT];  // at which each came last
    drops_t drops;
    uint16_t missed_ticks;    // since START; stops at its largest value
    uint16_t overruns;        // periods without a step, by the port; since START; likewise
    uint16_t overdue_ticks;   // periods that the port says passed without a step, since the last one
    bool status_owed;         // one found no room
    bool peer_matches;        // HELLO brought our protocol hash
    bool requests_known;      // a request has come since the last HELLO
    uint8_t request_counter;  // of that one
    bool tick_known;          // a tick has come since START
    bool sync_known;          // a SYNC has come since the host's ticks began
    bool located;             // a step has been made since START, from a pose that was read
    bool health_known;        // what follows of it
    bool crash_known;         // likewise
    uint8_t parameter_origin; // ORIGIN_…: where the parameters came from at the start, or were put since
    uint16_t key;             // that START must carry
    uint32_t key_state;       // what the next one is made of
    uint32_t key_age_ticks;   // since the last ARM
    uint32_t tick;            // of the last step: the host's in lockstep, else counted from START
    uint32_t sync_tick;       // of the last SYNC
    uint32_t sync_age_ticks;  // since it, by the port's timer
    uint32_t missed_in_row;   // ticks, without one on time between them
    reading_t pose;           // x1, x2 (m), θ (rad)
    reading_t wheel_speed;    // rad/s
    trajectory_cursor_t cursor;
    uint32_t advance_us; // of the trajectory's time that a period takes
    braking_t braking;
    control_state_t state;
    parameters_t parameters;
    parameters_t kept;        // those that the next start finds
    control_params_t control; // made from the parameters
    vec3_t torque_Nm;         // of the last step
    step_times_t step_times;
    app_health_t health;
    uint32_t crash_pc, crash_lr;
    frame_t torque_answer; // to the last tick
    frame_t slip_answer;
    store_t store;
    outbox_t outbox;
} app_t;

/// Ready in IDLE with default parameters and no trajectory.
void app_init(app_t *app, const robot_t *robot, uint8_t node, app_port_t port);

/// Where parameters outlive a reset, to be told right after app_init: those that are kept there are in force. Where
/// they are lost, the defaults are, with FAULT_PARAMETERS_LOST: a robot that was tuned says so before it moves.
void app_use_settings(app_t *app, const settings_memory_t *memory);

/// Takes one frame off the bus. Frames of other nodes and functions are ignored; damaged and replayed ones, and those
/// under this robot's own identifiers, are counted and change nothing else. Answers go to the outbox.
void app_receive(app_t *app, const frame_t *frame);

/// Gives the next frame for the bus; false when there is none.
bool app_transmit(app_t *app, frame_t *frame);

/// A period has passed by the port's timer: one step and its answers, if it is the timer that paces the robot.
void app_tick(app_t *app);

/// So many periods have passed without a step; to be told before the next app_tick, which moves time on by them.
void app_note_overrun(app_t *app, uint32_t periods);

/// Something that nobody can foresee, such as a clock's finest bits, before a frame is received: goes into the key of
/// the next ARM. Without it the keys are the same after every start, as a run that is to be repeated wants it.
void app_stir(app_t *app, uint32_t bits);

/// Wheel speeds by the port's encoders, before app_tick; taken in DRIVE_MOTORS. Those that no wheel has are none.
void app_set_wheel_speed(app_t *app, vec3_t rad_per_s);

/// What the motors have to give. False, and zeros, unless the robot drives its own motors: then their bridges are off.
bool app_motor_torque(const app_t *app, vec3_t *torque_Nm);

/// The motors can't give it: FAULT_SUPPLY, too little voltage, or FAULT_BRIDGE, a bridge has shut itself off. A fault
/// while the robot drives them, else nothing.
void app_note_motor_fault(app_t *app, uint8_t fault);

/// How long a step took, frames included; goes into TIMING.
void app_note_step_time(app_t *app, uint32_t step_ns);

/// What the board knows of itself now; goes into HEALTH.
void app_note_health(app_t *app, const app_health_t *health);

/// Where a processor fault ended the run before this one; goes into CRASH, once.
void app_note_crash(app_t *app, uint32_t pc, uint32_t lr);

#endif

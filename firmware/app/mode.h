// SPDX-License-Identifier: MIT
// Modes of the robot and what leads from one to another, as a table. The mode numbers are the wire's
// (protocol/omnibot.dbc).
#ifndef OMNIBOT_APP_MODE_H
#define OMNIBOT_APP_MODE_H

#include <stdbool.h>
#include <stdint.h>

typedef enum {
    EVENT_READY,   // initialisation is done
    EVENT_START,   // the host asks to drive, and nothing is missing
    EVENT_STOP,    // the host asks to stop
    EVENT_CLEAR,   // the host has seen the fault
    EVENT_RESTART, // the host's ticks went back: it is a new host
    EVENT_FAULT,
    EVENT_COUNT
} event_t;

/// The mode after an event; the same mode where the event has no meaning in it.
uint8_t mode_after(uint8_t mode, event_t event);

/// Only in these modes may a torque other than zero leave the robot.
bool mode_drives(uint8_t mode);

#endif

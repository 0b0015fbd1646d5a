// SPDX-License-Identifier: MIT
// Modes of the robot and what leads from one to another, as a table. The mode numbers are the wire's
// (protocol/omnibot.dbc).
#ifndef OMNIBOT_APP_MODE_H
#define OMNIBOT_APP_MODE_H

#include <stdbool.h>
#include <stdint.h>

typedef enum {
    EVENT_READY,           // initialisation is done
    EVENT_ARM,             // the host asks to be let drive, and nothing is missing
    EVENT_START,           // the host asks to drive, with the key that ARM gave it
    EVENT_LAPSE,           // the key was not used in time, or a wrong one was
    EVENT_STOP,            // the host asks to stop
    EVENT_REST,            // braking is over
    EVENT_REST_WITH_FAULT, // likewise, and a fault is latched
    EVENT_CLEAR,           // the host has seen the fault
    EVENT_RESTART,         // a new host is there
    EVENT_BRAKE,           // a fault that leaves the robot able to brake
    EVENT_CUT,             // one that does not
    EVENT_COUNT
} event_t;

/// The mode after an event; the same mode where the event has no meaning in it.
uint8_t mode_after(uint8_t mode, event_t event);

/// Only in these modes may a torque other than zero leave the robot: TRACKING and STOPPING.
bool mode_drives(uint8_t mode);

/// In these modes the robot stays where it is until somebody arms it: what it drives by may be changed.
bool mode_is_safe(uint8_t mode);

#endif

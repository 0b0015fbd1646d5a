// SPDX-License-Identifier: MIT
// Between the body and its three equal wheels at 120°. All such maps of the theory (J, J⁻¹, Jr⁻¹, Λ) are the drive
// directions, rows of Jr (K1), with three gains: so they cost four products each, not nine. Wheels 1, 2, 3 drive along
// (−√3/2, 1/2), (0, −1) and (√3/2, 1/2) of the body.
#ifndef OMNIBOT_CONTROL_WHEELS_H
#define OMNIBOT_CONTROL_WHEELS_H

#include "vec3.h"

/// Gains of a map: √3/2 and 1/2 of the planar one, and that of turning.
typedef struct {
    float ahead, side, turn;
} wheel_map_t;

/// What each wheel has of something of the body: the rows of Jr, scaled.
static inline vec3_t wheels_of_body(const wheel_map_t *map, vec3_t body)
{
    const float ahead = map->ahead * body.x, side = map->side * body.y, turn = map->turn * body.z;
    return (vec3_t){turn + side - ahead, turn - (side + side), turn + side + ahead};
}

/// What the body has of something of its wheels: the columns of Jr, scaled.
static inline vec3_t body_of_wheels(const wheel_map_t *map, vec3_t wheels)
{
    const float outer = wheels.x + wheels.z;
    return (vec3_t){
        map->ahead * (wheels.z - wheels.x),
        map->side * (outer - (wheels.y + wheels.y)),
        map->turn * (outer + wheels.y),
    };
}

#endif

// SPDX-License-Identifier: MIT
#include "control.h"

#include "kinematics.h"
#include "manifold.h"

/// c = ε κ: how much slip velocity a wheel force costs.
typedef struct {
    float mps_per_N;
    bool held_back; // at its bound, and so without a rate
} compliance_t;

/// What every stage of a step looks at.
typedef struct {
    const control_params_t *params;
    tracking_t tracking;
    vec3_t odometry;          // v_odo
    float odometry_speed_mps; // its V
    compliance_t compliance;
} step_t;

/// What the law asks for at a twist.
typedef struct {
    vec3_t twist;          // ν
    vec3_t eta;            // η
    vec3_t specific_force; // η + ω×ν
    vec3_t wheel_force_N;  // λ
} demand_t;

void control_prepare(control_params_t *params)
{
    const vec3_t at_rest = {0};
    const mat3_t gradient = tracking_gradient(params->robot, &params->law, at_rest);
    const float ratio_per_compliance = slip_mass_ratio(&params->robot->slip_mass, &gradient);
    params->compliance_max_mps_per_N = params->series_ratio_max / ratio_per_compliance;
    params->layer_s_per_mps = params->floor.compliance_per_N * params->robot->layer_lag_Ns2_per_m;
    floor_prepare(&params->floor);
}

/// The factor that brings a size down to a bound; 1 where it is within.
static float scale_to_bound(float size, float bound)
{
    return size > bound ? bound / size : 1.0f;
}

/// c = ε (V + δ)/G0 with the V of the encoders, held back so that ρ stays below its bound in translation and in yaw.
/// Theory (C9).
static compliance_t slip_compliance(const control_params_t *params, float odometry_speed_mps)
{
    const float wanted = params->floor.compliance_per_N * (odometry_speed_mps + params->delta_mps);
    const float most = params->compliance_max_mps_per_N;
    const bool held_back = wanted > most;
    return (compliance_t){.mps_per_N = held_back ? most : wanted, .held_back = held_back};
}

static demand_t demand_at(const step_t *step, vec3_t twist)
{
    const robot_t *robot = step->params->robot;
    const vec3_t eta = tracking_eta(robot, &step->params->law, &step->tracking, twist);
    const vec3_t specific_force = vec3_add_turn(eta, twist.z, twist);
    return (demand_t){twist, eta, specific_force, manifold_force(robot, specific_force)};
}

/// ν = v_odo − c Jr⁻¹ λ with the force that the floor will really be asked for. Theory (C5).
static vec3_t twist_of_force(const step_t *step, vec3_t force_N)
{
    const float bounded = scale_to_bound(vec3_max_abs(force_N), step->params->force_bound_N);
    const vec3_t slip_twist = body_of_wheels(&step->params->robot->twist_of_contact_speed, force_N);
    return vec3_add_scaled(step->odometry, -step->compliance.mps_per_N * bounded, slip_twist);
}

/// A Newton step from v_odo on ν + c Jr⁻¹ λ(ν) = v_odo, which is linear but for ω², given the first round's ν. Theory
/// (C7).
static vec3_t newton_step(const step_t *step, vec3_t first_round)
{
    const robot_t *robot = step->params->robot;
    const mat3_t gradient = tracking_gradient(robot, &step->params->law, step->odometry);
    const mat3_t system = slip_mass_system(&robot->slip_mass, step->compliance.mps_per_N, &gradient);
    return vec3_add(step->odometry, mat3_solve(&system, vec3_sub(first_round, step->odometry)));
}

/// V + δ where V is the speed of the twist looked for, ν = v_odo − (V + δ) s: the root of a quadratic that is v_odo's
/// own speed without slip. Slip ratios beyond one leave no root near it; then the nearest of δ … twice v_odo's is
/// taken. Theory (O3).
static float speed_behind_slip(const step_t *step, vec3_t slip_twist)
{
    const float delta = step->params->delta_mps, length_m = step->params->speed_length_m;
    const float speed = step->odometry_speed_mps;
    const float n = kinematics_speed_product(slip_twist, slip_twist, length_m);
    const float p = kinematics_speed_product(step->odometry, slip_twist, length_m) - delta;
    const float q = (speed - delta) * (speed + delta);
    const float discriminant = p * p + (1.0f - n) * q;
    const float denominator = p + sqrtf(discriminant > 0.0f ? discriminant : 0.0f);
    const float root = q > 0.0f && denominator > 0.0f ? q / denominator : speed + delta;
    const float most = 2.0f * (speed + delta);
    const float bounded = root < most ? root : most;
    return bounded > delta ? bounded : delta;
}

/// ν from the slip that the forces of the past have made, on the traction curve. Theory (O2).
static vec3_t twist_of_observer(const step_t *step, vec3_t force_estimate_N)
{
    const control_params_t *params = step->params;
    const vec3_t slip_ratio = floor_slip_ratios(&params->floor, force_estimate_N);
    const vec3_t slip_twist = body_of_wheels(&params->robot->twist_of_contact_speed, slip_ratio);
    return vec3_add_scaled(step->odometry, -speed_behind_slip(step, slip_twist), slip_twist);
}

/// The demand to order N of the expansion, each round adding one power of ε (C5); or to its limit, which is a round, a
/// Newton step and a round more (C7); or from the observer's twist on.
static demand_t corrected_demand(const step_t *step, vec3_t force_estimate_N)
{
    const int32_t order = step->params->order;
    const bool observed = order == CONTROL_OBSERVER, limit = order == CONTROL_EXACT;
    const int32_t rounds = observed ? 0 : limit ? 2 : order;
    demand_t demand = demand_at(step, observed ? twist_of_observer(step, force_estimate_N) : step->odometry);
    for (int32_t k = 0; k < rounds; k++) {
        const vec3_t twist = twist_of_force(step, demand.wheel_force_N);
        demand = demand_at(step, limit && k == 0 ? newton_step(step, twist) : twist);
    }
    return demand;
}

/// c ḟ + ċ f of the specific force f = ν̇ + ω×ν, so that −σ̇ = Λ (c ḟ + ċ f). Theory (M5).
static vec3_t slip_specific_rate(const step_t *step, const demand_t *demand, float speed_mps)
{
    const control_params_t *params = step->params;
    const vec3_t eta_rate = tracking_eta_rate(params->robot, &params->law, &step->tracking, demand->twist, demand->eta);
    const vec3_t specific_rate = manifold_specific_force_rate(demand->twist, demand->eta, eta_rate);
    const float speed_rate = kinematics_speed_rate(demand->twist, speed_mps, demand->eta, params->speed_length_m);
    const float c_rate = step->compliance.held_back ? 0.0f : params->floor.compliance_per_N * speed_rate;
    const vec3_t scaled = vec3_scale(step->compliance.mps_per_N, specific_rate);
    return vec3_add_scaled(scaled, c_rate, demand->specific_force);
}

/// Iw φ̈ with φ̈ = (Jr η − σ̇)/r; as Λ = Jr (JrᵀJr)⁻¹Mo, that is J of η and of what −σ̇ would be of the body. Theory (M5).
static vec3_t inertia_torque(const step_t *step, const demand_t *demand, float speed_mps)
{
    const robot_t *robot = step->params->robot;
    vec3_t body_acceleration = demand->eta;
    if (step->params->order != 0) {
        const vec3_t slip_rate = slip_mass_times(&robot->slip_mass, slip_specific_rate(step, demand, speed_mps));
        body_acceleration = vec3_add(demand->eta, slip_rate);
    }
    return wheels_of_body(&robot->inertia_torque_of_accel, body_acceleration);
}

/// How far the slip gets in one period on its way to what the force makes of it: 1 − e^(−T/τ), τ the time constant of
/// the boundary layer (18) and of any lag besides; e^x to its cubic term, over a common denominator. Theory (O1).
static float observer_gain(const control_params_t *params, float speed_mps, float period_s)
{
    const float layer_s = params->layer_s_per_mps * (speed_mps + params->delta_mps);
    const float tau_s = layer_s + params->observer_lag_s + 1.0e-3f * period_s; // no lag at all is far below a period
    const float half_s = 0.5f * period_s;
    const float rise = period_s * (tau_s * (tau_s + half_s) + (2.0f / 3.0f) * half_s * half_s);
    return rise / (tau_s * tau_s * tau_s + rise);
}

/// Moves the state a period on, with the torque held: λ̂ follows the forces asked for (O1), the pose the twist (K5).
static void advance(const control_params_t *params, control_state_t *state, rotation_t heading, float speed_mps)
{
    const float period_s = params->robot->control_period_s;
    const float gain = observer_gain(params, speed_mps, period_s);
    const vec3_t lag = vec3_sub(state->wheel_force_N, state->force_estimate_N);
    const vec3_t acceleration = vec3_add_turn(state->specific_force, -state->twist.z, state->twist);
    const vec3_t halfway = vec3_add_scaled(state->twist, 0.5f * period_s, acceleration);
    state->force_estimate_N = vec3_add_scaled(state->force_estimate_N, gain, lag);
    state->pose = kinematics_moved_pose(state->pose, heading, halfway, period_s);
    state->twist = vec3_add_scaled(state->twist, period_s, acceleration);
}

void control_coast(const control_params_t *params, control_state_t *state)
{
    const float speed_mps = kinematics_speed(state->twist, params->speed_length_m);
    advance(params, state, rotation_of(state->pose.value.z), speed_mps);
}

static step_t step_of(const control_params_t *params, vec3_t pose, const control_input_t *input)
{
    const vec3_t odometry = kinematics_odometry(params->robot, input->wheel_speed_rad_per_s);
    const float speed_mps = kinematics_speed(odometry, params->speed_length_m);
    return (step_t){
        .params = params,
        .tracking = tracking_from(params->robot, &params->law, pose, &input->reference),
        .odometry = odometry,
        .odometry_speed_mps = speed_mps,
        .compliance = slip_compliance(params, speed_mps),
    };
}

/// τ = r λ + Iw φ̈ (32), (29), with λ and then τ held within their bounds.
static void bounded_output(const step_t *step, const demand_t *demand, float speed_mps, control_output_t *output)
{
    const control_params_t *params = step->params;
    const robot_t *robot = params->robot;
    const float force_scale = scale_to_bound(vec3_max_abs(demand->wheel_force_N), params->force_bound_N);
    const vec3_t rolling = vec3_scale(robot->wheel_radius_m, demand->wheel_force_N);
    const vec3_t torque = vec3_add(rolling, inertia_torque(step, demand, speed_mps));
    const float torque_scale = scale_to_bound(force_scale * vec3_max_abs(torque), params->torque_bound_Nm);
    const float scale = force_scale * torque_scale;
    const float mobility = (speed_mps + params->delta_mps) * robot->normalised_compliance_per_N;
    const vec3_t wheel_force = vec3_scale(scale, demand->wheel_force_N);
    output->torque_Nm = vec3_scale(scale, torque);
    output->mu_mps = manifold_of_force(robot, mobility, wheel_force);
    output->wheel_force_N = wheel_force;
    output->specific_force = vec3_scale(scale, demand->specific_force);
    output->twist = demand->twist;
    output->eta = demand->eta;
    output->error = step->tracking.error;
    output->force_bounded = force_scale < 1.0f;
    output->torque_bounded = torque_scale < 1.0f;
}

/// A sum is finite only if each of its terms is. What is not finite on the way in comes out here: no bound and no
/// choice on the way makes a number of it, and each of µ has every force in it.
static bool is_finite(const control_output_t *output)
{
    return isfinite(vec3_sum(output->torque_Nm) + output->mu_mps.x);
}

bool control_step(const control_params_t *params, control_state_t *state, const control_input_t *input,
                  control_output_t *output)
{
    const vec3_t *pose = input->pose_is_new ? &input->pose : &state->pose.value;
    const step_t step = step_of(params, *pose, input);
    const demand_t demand = corrected_demand(&step, state->force_estimate_N);
    const float speed_mps = kinematics_speed(demand.twist, params->speed_length_m);
    bounded_output(&step, &demand, speed_mps, output);
    if (!is_finite(output)) {
        *output = (control_output_t){0};
        return false;
    }
    if (input->pose_is_new) {
        state->pose = (pose_sum_t){.value = input->pose, .rest = {0.0f, 0.0f, 0.0f}};
    }
    state->twist = output->twist;
    state->wheel_force_N = output->wheel_force_N;
    state->specific_force = output->specific_force;
    advance(params, state, step.tracking.heading, speed_mps);
    return true;
}

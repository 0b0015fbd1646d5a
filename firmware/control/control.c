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
    vec3_t odometry; // v_odo
    compliance_t compliance;
} step_t;

/// What the law asks for.
typedef struct {
    vec3_t twist;              // ν
    vec3_t eta;                // η
    vec3_t wheel_force_N;      // λ
    vec3_t wheel_acceleration; // φ̈
} demand_t;

static bool input_is_finite(const control_input_t *input)
{
    return vec3_is_finite(input->pose) && vec3_is_finite(input->wheel_speed_rad_per_s) &&
           vec3_is_finite(input->reference.position) && vec3_is_finite(input->reference.velocity) &&
           vec3_is_finite(input->reference.acceleration) && vec3_is_finite(input->reference.jerk);
}

/// The factor that brings the largest entry down to a bound; 1 where it is within.
static float scale_to_bound(vec3_t value, float bound)
{
    const float largest = vec3_max_abs(value);
    return largest > bound ? bound / largest : 1.0f;
}

/// c = ε (V + δ)/G0 with the V of the encoders, held back so that ρ stays below its bound in translation and in yaw.
/// Theory (C9).
static compliance_t slip_compliance(const control_params_t *params, vec3_t odometry)
{
    const mat3_t *mass_kg = &params->robot->slip_twist_of_accel;
    const float translation = mass_kg->m[0][0] * params->law.damping_per_s.x;
    const float heading_damping = params->law.output == OUTPUT_POSTURE ? params->law.damping_per_s.z : 0.0f;
    const float yaw = mass_kg->m[2][2] * heading_damping;
    const float speed_mps = kinematics_speed(odometry, params->speed_length_m) + params->delta_mps;
    const float wanted = params->floor.compliance_per_N * speed_mps;
    const float most = params->series_ratio_max / (translation > yaw ? translation : yaw);
    const bool held_back = wanted > most;
    return (compliance_t){.mps_per_N = held_back ? most : wanted, .held_back = held_back};
}

static vec3_t force_at(const step_t *step, vec3_t twist)
{
    const control_params_t *params = step->params;
    const vec3_t eta = tracking_eta(params->robot, &params->law, &step->tracking, twist);
    return manifold_force(params->robot, twist, eta);
}

/// ν = v_odo − c Jr⁻¹ λ with the force that the floor will really be asked for. Theory (C5).
static vec3_t twist_of_force(const step_t *step, vec3_t force_N)
{
    const float bounded = scale_to_bound(force_N, step->params->force_bound_N);
    const vec3_t slip_twist = mat3_apply(&step->params->robot->twist_of_contact_speed, force_N);
    return vec3_add_scaled(step->odometry, -step->compliance.mps_per_N * bounded, slip_twist);
}

/// ν to order N of the expansion: each round adds one power of ε. Theory (C5).
static vec3_t twist_of_series(const step_t *step, int32_t order)
{
    vec3_t twist = step->odometry;
    for (int32_t k = 0; k < order; k++) {
        twist = twist_of_force(step, force_at(step, twist));
    }
    return twist;
}

/// ν of the series' limit: one Newton step from v_odo on ν + c Jr⁻¹ λ(ν) = v_odo, which is linear but for ω². Theory
/// (C7).
static vec3_t twist_of_limit(const step_t *step)
{
    const robot_t *robot = step->params->robot;
    const mat3_t gradient = tracking_gradient(robot, &step->params->law, step->odometry);
    const mat3_t system = mat3_identity_plus(step->compliance.mps_per_N, &robot->slip_twist_of_accel, &gradient);
    const vec3_t residual = vec3_sub(twist_of_force(step, force_at(step, step->odometry)), step->odometry);
    const vec3_t twist = vec3_add(step->odometry, mat3_solve(&system, residual));
    return twist_of_force(step, force_at(step, twist));
}

/// V + δ where V is the speed of the twist looked for, ν = v_odo − (V + δ) s: the root of a quadratic that is v_odo's
/// own speed without slip. Slip ratios beyond one leave no root near it; then the nearest of δ … twice v_odo's is
/// taken. Theory (O3).
static float speed_behind_slip(const control_params_t *params, vec3_t odometry, vec3_t slip_twist)
{
    const float delta = params->delta_mps, length_m = params->speed_length_m;
    const float speed = kinematics_speed(odometry, length_m);
    const float n = kinematics_speed_product(slip_twist, slip_twist, length_m);
    const float p = kinematics_speed_product(odometry, slip_twist, length_m) - delta;
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
    const vec3_t slip_twist = mat3_apply(&params->robot->twist_of_contact_speed, slip_ratio);
    return vec3_add_scaled(step->odometry, -speed_behind_slip(params, step->odometry, slip_twist), slip_twist);
}

static vec3_t corrected_twist(const step_t *step, const control_state_t *state)
{
    if (step->params->order == CONTROL_OBSERVER) {
        return twist_of_observer(step, state->force_estimate_N);
    }
    if (step->params->order == CONTROL_EXACT) {
        return twist_of_limit(step);
    }
    return twist_of_series(step, step->params->order);
}

/// φ̈ = (Jr η − σ̇)/r with σ̇ = −c λ̇ − ċ λ. Theory (M5).
static vec3_t wheel_acceleration(const step_t *step, vec3_t twist, vec3_t eta, vec3_t force_N)
{
    const control_params_t *params = step->params;
    const robot_t *robot = params->robot;
    const vec3_t rolling = mat3_apply(&robot->wheel_rate_of_twist, eta);
    if (params->order == 0) {
        return rolling;
    }
    const vec3_t eta_rate = tracking_eta_rate(robot, &params->law, &step->tracking, twist, eta);
    const vec3_t force_rate = manifold_force_rate(robot, twist, eta, eta_rate);
    const float speed_rate = kinematics_speed_rate(twist, eta, params->speed_length_m);
    const float c_rate = step->compliance.held_back ? 0.0f : params->floor.compliance_per_N * speed_rate;
    const vec3_t slip_rate = vec3_add_scaled(vec3_scale(-step->compliance.mps_per_N, force_rate), -c_rate, force_N);
    return vec3_add_scaled(rolling, -1.0f / robot->wheel_radius_m, slip_rate);
}

static demand_t demand_at(const step_t *step, vec3_t twist)
{
    const robot_t *robot = step->params->robot;
    const vec3_t eta = tracking_eta(robot, &step->params->law, &step->tracking, twist);
    const vec3_t force_N = manifold_force(robot, twist, eta);
    return (demand_t){
        .twist = twist,
        .eta = eta,
        .wheel_force_N = force_N,
        .wheel_acceleration = wheel_acceleration(step, twist, eta, force_N),
    };
}

/// τ = r λ + Iw φ̈ (32), (29), with λ and then τ held within their bounds.
static void bounded_torque(const control_params_t *params, const demand_t *demand, control_output_t *output)
{
    const robot_t *robot = params->robot;
    const float force_scale = scale_to_bound(demand->wheel_force_N, params->force_bound_N);
    const vec3_t force = vec3_scale(force_scale, demand->wheel_force_N);
    const vec3_t rolling = vec3_scale(robot->wheel_radius_m, force);
    const vec3_t torque = vec3_add_scaled(rolling, force_scale * robot->wheel_inertia_kgm2, demand->wheel_acceleration);
    const float torque_scale = scale_to_bound(torque, params->torque_bound_Nm);
    output->torque_Nm = vec3_scale(torque_scale, torque);
    output->wheel_force_N = vec3_scale(torque_scale, force);
    output->force_bounded = force_scale < 1.0f;
    output->torque_bounded = torque_scale < 1.0f;
}

/// How far the slip gets in one period on its way to what the force makes of it: 1 − e^(−T/τ), τ the time constant of
/// the boundary layer (18) and of any lag besides; e^x to its cubic term. Theory (O1).
static float observer_gain(const control_params_t *params, float speed_mps, float period_s)
{
    const float layer_s = params->floor.compliance_per_N * speed_mps / params->robot->layer_rate_m_per_Ns2;
    const float tau_s = layer_s + params->observer_lag_s;
    const float x = period_s / (tau_s + 1.0e-3f * period_s); // no lag at all is a lag far below a period
    return 1.0f - 1.0f / (1.0f + x * (1.0f + x * (0.5f + x * (1.0f / 6.0f))));
}

/// The state a period on, with the torque held: λ̂ follows the forces asked for (O1), the pose the twist (K5).
static control_state_t next_state(const control_params_t *params, const control_state_t *now)
{
    const vec3_t lag = vec3_sub(now->wheel_force_N, now->force_estimate_N);
    const float period_s = (float)params->robot->control_period_us * 1.0e-6f;
    const float speed_mps = kinematics_speed(now->twist, params->speed_length_m) + params->delta_mps;
    const float gain = observer_gain(params, speed_mps, period_s);
    const vec3_t acceleration = manifold_acceleration(params->robot, now->twist, now->wheel_force_N);
    const vec3_t halfway = vec3_add_scaled(now->twist, 0.5f * period_s, acceleration);
    return (control_state_t){
        .force_estimate_N = vec3_add_scaled(now->force_estimate_N, gain, lag),
        .pose = kinematics_moved_pose(now->pose, halfway, period_s),
        .twist = vec3_add_scaled(now->twist, period_s, acceleration),
        .wheel_force_N = now->wheel_force_N,
    };
}

void control_coast(const control_params_t *params, control_state_t *state)
{
    *state = next_state(params, state);
}

bool control_step(const control_params_t *params, control_state_t *state, const control_input_t *input,
                  control_output_t *output)
{
    *output = (control_output_t){0};
    pose_sum_t pose = state->pose;
    if (input->pose_is_new) {
        pose = (pose_sum_t){.value = input->pose};
    }
    if (!input_is_finite(input) || !vec3_is_finite(pose.value)) {
        return false;
    }
    const vec3_t odometry = kinematics_odometry(params->robot, input->wheel_speed_rad_per_s);
    const step_t step = {
        .params = params,
        .tracking = tracking_from(params->robot, pose.value, &input->reference),
        .odometry = odometry,
        .compliance = slip_compliance(params, odometry),
    };
    const demand_t demand = demand_at(&step, corrected_twist(&step, state));
    bounded_torque(params, &demand, output);
    const float mobility = (kinematics_speed(demand.twist, params->speed_length_m) + params->delta_mps) /
                           params->robot->normalised_stiffness_N;
    output->mu_mps = manifold_of_force(params->robot, mobility, output->wheel_force_N);
    output->twist = demand.twist;
    output->eta = demand.eta;
    output->error = step.tracking.error;
    const control_state_t now = {
        .force_estimate_N = state->force_estimate_N,
        .pose = pose,
        .twist = output->twist,
        .wheel_force_N = output->wheel_force_N,
    };
    const control_state_t next = next_state(params, &now);
    if (!vec3_is_finite(output->torque_Nm) || !vec3_is_finite(output->mu_mps) || !vec3_is_finite(next.pose.value)) {
        *output = (control_output_t){0};
        return false;
    }
    *state = next;
    return true;
}

// What the simulator says and is told, as its module defines it.

export type Vec3 = [number, number, number];
export type Pose = [number, number, number, number, number, number];

/** What moves an arm: the policy of a slot, its servos, or nothing. */
export type Control = { policy: number } | "hold" | "limp";

export type Effect =
    | { wrench: { body: number; point: Vec3; force: Vec3; torque: Vec3 } }
    | { hand_force: { arm: number; force: Vec3 } }
    | { base_torque: Vec3 }
    | { joint_torque: { std: number } };

/** Something that happens before a control step. */
export type Event =
    | { hand_goal: { arm: number; pose: Pose } }
    | { base_goal: { attitude: Vec3 } }
    | { arm: { arm: number; control: Control } }
    | { effect: { effect: Effect; steps?: number | null } }
    | "clear_effects"
    | { base_mass: { mass: number } }
    | { delay: { steps: number } }
    | { sensors: { position: number; angle: number; velocity: number; rate: number } };

/** Whether an event acts over time. What it does to the moment before which it happens is nothing. */
export function isEffect(event: Event): boolean {
    return event === "clear_effects" || "effect" in event;
}

/** How an episode begins. */
export interface Start {
    /** A text where it is larger than a number can hold. */
    seed?: number | string;
    purpose?: "evaluation" | "training";
    iteration?: number;
    episode?: number;
    state?: number[];
}

/** An episode that plays again. */
export interface Script {
    start: Start;
    steps: number;
    events: { step: number; event: Event }[];
}

export type Shape =
    | { capsule: { from: Vec3; to: Vec3; radius: number } }
    | { disc: { centre: Vec3; axis: Vec3; radius: number; half_height: number } }
    | { box: { name: string; half: Vec3; centre: Vec3; rotation: number[] } };

export interface Body {
    name: string;
    arm: number | null;
    shapes: Shape[];
}

export const ARRAYS = [
    "state", "bodies", "hands", "hand_goals", "base_goal", "hand_errors", "base_errors", "position_error",
    "orientation_error", "base_error", "actions", "commands", "torques", "touching", "contacts", "counters",
] as const;
export type ArrayName = (typeof ARRAYS)[number];

/** What a task has goals for. */
export interface Aims {
    /** Arms whose hands have goals. */
    hands: number[];
    base: boolean;
}

/** The robot and where the simulator keeps its numbers. */
export interface Description {
    robot: string;
    task: string[];
    /** What the tasks that there are have goals for. */
    aims: Record<string, Aims>;
    n_arms: number;
    n_joints: number;
    /** By arm: its first joint, and the first behind its last. */
    joints: [number, number][];
    control_period: number;
    max_rates: number[];
    max_torques: number[];
    base_mass: number;
    arms: string[];
    bodies: Body[];
    arrays: Record<ArrayName, { at: number; len: number }>;
}

/** Every number of a moment, in the order of `ARRAYS`. */
export type Frame = Record<ArrayName, Float32Array>;

/** A block of a run: what all environments of a shard did in an iteration. */
export interface Block {
    /** A text, as a number does not hold all seeds. */
    seed: string;
    digest: string;
    env_steps: number;
    /** Of an episode, mean over environments, an agent each. */
    returns: number[];
}

/** The three files of a policy. */
export interface PolicyFiles {
    config: Uint8Array;
    robot: Uint8Array;
    tensors: Uint8Array;
}

/** What the policies that move the robot have goals for. */
export function aimsOf({ task, aims }: Pick<Description, "task" | "aims">): Aims {
    return { hands: task.flatMap((name) => aims[name]?.hands ?? []), base: task.some((name) => aims[name]?.base) };
}

// The scene: everything that is drawn of a moment, and what a pointer does to it.

import * as THREE from "three";
import type { Timeline } from "../simulation/timeline";
import { aimsOf, type Description } from "../simulation/types";
import { bodiesBetween } from "./between";
import { Flashes } from "./contacts";
import { type Goal, Goals } from "./goals";
import { Push } from "./push";
import { RobotView } from "./robot";
import { Stage } from "./stage";
import { Trails } from "./trails";

export type Followed = "nothing" | "base" | number;

export class View {
    readonly stage: Stage;
    readonly goals: Goals;
    readonly push: Push;
    trailsShown = true;
    private readonly trails = new Trails();
    private readonly flashes = new Flashes();
    private robot: RobotView | undefined;
    private joints: Description["joints"] = [];
    private bodies: THREE.Matrix4[] = [];
    private hands: THREE.Matrix4[] = [];
    private flashed = -1;
    private readonly base = new THREE.Vector3();
    private readonly ray = new THREE.Raycaster();

    constructor(
        element: HTMLElement,
        private readonly timeline: Timeline,
    ) {
        this.stage = new Stage(element);
        this.goals = new Goals(this.stage);
        this.push = new Push(this.stage, () => this.robot?.bodies ?? []);
        this.stage.scene.add(this.trails.group, this.flashes.group, this.push.group);
        this.listen(this.stage.renderer.domElement);
    }

    /** A robot has come, perhaps another one. */
    begin(): void {
        const { description } = this.timeline;
        if (this.robot !== undefined) {
            this.stage.scene.remove(this.robot.group);
            this.robot.dispose();
        }
        this.robot = new RobotView(description);
        this.stage.scene.add(this.robot.group);
        this.joints = description.joints;
        this.bodies = description.bodies.map(() => new THREE.Matrix4());
        this.hands = description.arms.map(() => new THREE.Matrix4());
        this.trails.robot(description.n_arms);
        this.goals.robot(description);
        this.flashed = -1;
    }

    follow(what: Followed): void {
        const at = new THREE.Vector3();
        if (what === "nothing") this.stage.follow = undefined;
        else if (what === "base") this.stage.follow = () => at.copy(this.base);
        else this.stage.follow = () => at.setFromMatrixPosition(this.hands[what] as THREE.Matrix4);
    }

    /** Draws where the timeline stands. */
    draw(seconds: number): void {
        const { timeline, robot } = this;
        const at = Math.floor(timeline.cursor);
        const from = timeline.frames[at];
        if (robot === undefined || from === undefined) return;
        const to = timeline.frames[at + 1] ?? from;
        const share = timeline.cursor - at;
        bodiesBetween(from.bodies, to.bodies, share, this.joints, this.bodies);
        this.bodies.forEach((matrix, body) => robot.pose(body, matrix));
        this.placeHands(from.bodies, from.hands);
        this.base.setFromMatrixPosition(this.bodies[0] as THREE.Matrix4);
        const nearest = share < 0.5 ? from : to;
        const aims = aimsOf(timeline.description);
        const visible = (goal: Goal): boolean => (goal === "base" ? aims.base : aims.hands.includes(goal)) || this.goals.selected === goal;
        this.goals.show(nearest, this.base, visible);
        this.trails.group.visible = this.trailsShown;
        if (this.trailsShown) this.trails.show(timeline.frames, timeline.cursor, this.hands);
        if (at !== this.flashed) {
            this.flashed = at;
            for (const body of this.flashes.show(from)) robot.touch(body);
        }
        this.flashes.tick(seconds);
        robot.tick(seconds);
        this.push.update();
        this.stage.draw();
    }

    /** Hands are fixed to the last links. */
    private placeHands(bodies: Float32Array, hands: Float32Array): void {
        const link = new THREE.Matrix4();
        this.hands.forEach((hand, arm) => {
            const last = this.joints[arm]?.[1] ?? 0;
            link.fromArray(bodies, 16 * last).invert();
            hand.fromArray(hands, 16 * arm).premultiply(link).premultiply(this.bodies[last] as THREE.Matrix4);
        });
    }

    private aim(event: PointerEvent): THREE.Raycaster {
        const place = this.stage.renderer.domElement.getBoundingClientRect();
        const x = (2 * (event.clientX - place.left)) / place.width - 1;
        const y = 1 - (2 * (event.clientY - place.top)) / place.height;
        this.ray.setFromCamera(new THREE.Vector2(x, y), this.stage.camera);
        return this.ray;
    }

    private listen(canvas: HTMLCanvasElement): void {
        let down: { x: number; y: number } | undefined;
        canvas.addEventListener(
            "pointerdown",
            (event) => {
                down = { x: event.clientX, y: event.clientY };
                if (!event.isPrimary || event.button !== 0 || this.goals.busy) return;
                const ray = this.aim(event);
                const goal = this.goals.under(ray);
                if (goal !== undefined) {
                    this.goals.select(goal);
                    return;
                }
                if (this.push.begin(ray)) canvas.setPointerCapture(event.pointerId);
            },
            // Before the orbit, which is not to turn while a body is held.
            { capture: true },
        );
        canvas.addEventListener("pointermove", (event) => {
            if (this.push.active) this.push.move(this.aim(event));
        });
        const up = (event: PointerEvent): void => {
            const still = down !== undefined && Math.hypot(event.clientX - down.x, event.clientY - down.y) < 4;
            // A click beside everything lets go of the goal.
            if (still && !this.push.active && !this.goals.busy && this.goals.under(this.aim(event)) === undefined) this.goals.select(undefined);
            this.push.end();
        };
        canvas.addEventListener("pointerup", up);
        canvas.addEventListener("pointercancel", up);
    }
}


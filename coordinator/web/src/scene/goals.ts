// Goals as axes, and the handles by which they are dragged and turned.

import * as THREE from "three";
import { TransformControls } from "three/addons/controls/TransformControls.js";
import type { Description, Event, Frame, Pose, Vec3 } from "../simulation/types";
import { axes } from "./axes";
import { ofArm } from "./colours";
import type { Stage } from "./stage";

/** Which goal: that of an arm's hand, or that of the base. */
export type Goal = number | "base";
export type Handle = "translate" | "rotate";

/** Euler angles about x, y, z have no one answer at a quarter turn about y. */
const LARGEST_MIDDLE = 1.4;

export class Goals {
    onChange: (goal: Goal, event: Event) => void = () => undefined;
    onSelect: () => void = () => undefined;
    selected: Goal | undefined;
    private readonly marks = new Map<Goal, THREE.Group>();
    private readonly handles: TransformControls;
    private readonly helper: THREE.Object3D;
    private readonly place = new THREE.Vector3();

    constructor(private readonly stage: Stage) {
        this.handles = new TransformControls(stage.camera, stage.renderer.domElement);
        this.handles.setSize(0.7);
        this.helper = this.handles.getHelper();
        stage.scene.add(this.helper);
        this.handles.addEventListener("dragging-changed", ({ value }) => (stage.orbit.enabled = !value));
        this.handles.addEventListener("objectChange", () => this.changed());
    }

    /** Whether a handle is held, or would be by the next click. */
    get busy(): boolean {
        return this.handles.dragging || this.handles.axis !== null;
    }

    /** The handle under the pointer, `X`, `YZ` and so on. */
    get axis(): string | null {
        return this.handles.axis;
    }

    get mode(): Handle {
        return this.handles.mode as Handle;
    }

    robot(description: Description): void {
        this.select(undefined);
        for (const mark of this.marks.values()) {
            this.stage.scene.remove(mark);
            mark.traverse((object) => {
                if (!(object instanceof THREE.Mesh)) return;
                (object.geometry as THREE.BufferGeometry).dispose();
                (object.material as THREE.Material).dispose();
            });
        }
        this.marks.clear();
        for (let arm = 0; arm < description.n_arms; arm++) this.add(arm, axes(0.2, 0.008, ofArm(arm)));
        const cube = axes(0.75, 0.008, "#8b95a5");
        this.add("base", cube);
    }

    private add(goal: Goal, mark: THREE.Group): void {
        mark.traverse((object) => (object.userData["goal"] = goal));
        this.marks.set(goal, mark);
        this.stage.scene.add(mark);
    }

    /** Shows the goals of a moment; the one that is being dragged is where the pointer is. `base` as it is drawn. */
    show(frame: Frame, base: THREE.Vector3, visible: (goal: Goal) => boolean): void {
        this.place.copy(base);
        for (const [goal, mark] of this.marks) {
            mark.visible = visible(goal);
            if (this.handles.dragging && this.selected === goal) {
                if (goal === "base") mark.position.copy(base);
                continue;
            }
            if (goal === "base") {
                mark.position.copy(base);
                const [a = 0, b = 0, c = 0] = frame.base_goal;
                mark.quaternion.setFromEuler(new THREE.Euler(a, b, c, "XYZ"));
            } else {
                const [x = 0, y = 0, z = 0, a = 0, b = 0, c = 0] = frame.hand_goals.subarray(6 * goal, 6 * goal + 6);
                mark.position.set(x, y, z);
                mark.quaternion.setFromEuler(new THREE.Euler(a, b, c, "XYZ"));
            }
        }
        this.helper.visible = this.selected !== undefined && visible(this.selected);
    }

    /** The goal under the pointer. */
    under(ray: THREE.Raycaster): Goal | undefined {
        const shown = [...this.marks.values()].filter((mark) => mark.visible);
        return ray.intersectObjects(shown, true)[0]?.object.userData["goal"] as Goal | undefined;
    }

    select(goal: Goal | undefined): void {
        this.selected = goal;
        const mark = goal === undefined ? undefined : this.marks.get(goal);
        if (mark === undefined) this.handles.detach();
        else this.handles.attach(mark);
        // The base's goal is an attitude.
        if (goal === "base") this.handles.setMode("rotate");
        this.onSelect();
    }

    setMode(mode: Handle): void {
        if (this.selected === "base" && mode === "translate") return;
        this.handles.setMode(mode);
        this.onSelect();
    }

    /** Where a goal's mark is. */
    position(goal: Goal): THREE.Vector3 | undefined {
        return this.marks.get(goal)?.position;
    }

    private changed(): void {
        const goal = this.selected;
        const mark = goal === undefined ? undefined : this.marks.get(goal);
        if (goal === undefined || mark === undefined) return;
        const { x: a, y, z: c } = new THREE.Euler().setFromQuaternion(mark.quaternion, "XYZ");
        const b = Math.max(-LARGEST_MIDDLE, Math.min(LARGEST_MIDDLE, y));
        if (goal === "base") {
            const attitude: Vec3 = [a, b, c];
            this.onChange(goal, { base_goal: { attitude } });
        } else {
            const pose: Pose = [mark.position.x, mark.position.y, mark.position.z, a, b, c];
            this.onChange(goal, { hand_goal: { arm: goal, pose } });
        }
    }
}

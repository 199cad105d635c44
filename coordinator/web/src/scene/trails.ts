// The ways of the hands, as lines behind them.

import * as THREE from "three";
import type { Frame } from "../simulation/types";
import { ofArm } from "./colours";

/** Control steps that a trail is long: 40 s. */
const LENGTH = 100;

export class Trails {
    readonly group = new THREE.Group();
    private lines: THREE.Line<THREE.BufferGeometry, THREE.LineBasicMaterial>[] = [];

    robot(arms: number): void {
        this.group.clear();
        for (const { geometry, material } of this.lines) {
            geometry.dispose();
            material.dispose();
        }
        this.lines = Array.from({ length: arms }, (_, arm) => {
            const geometry = new THREE.BufferGeometry();
            geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(3 * (LENGTH + 2)), 3));
            const material = new THREE.LineBasicMaterial({ color: ofArm(arm), transparent: true, opacity: 0.75 });
            const line = new THREE.Line(geometry, material);
            line.frustumCulled = false;
            this.group.add(line);
            return line;
        });
    }

    /** Up to the moment `cursor`, where the hands are at `hands`. */
    show(frames: Frame[], cursor: number, hands: THREE.Matrix4[]): void {
        const last = Math.floor(cursor);
        const first = Math.max(0, last - LENGTH);
        this.lines.forEach((line, arm) => {
            const position = line.geometry.getAttribute("position") as THREE.BufferAttribute;
            let n = 0;
            for (let step = first; step <= last; step++) {
                const of = frames[step]?.hands;
                if (of === undefined) continue;
                const at = 16 * arm + 12;
                position.setXYZ(n++, of[at] ?? 0, of[at + 1] ?? 0, of[at + 2] ?? 0);
            }
            const now = hands[arm]?.elements;
            if (now !== undefined) position.setXYZ(n++, now[12] ?? 0, now[13] ?? 0, now[14] ?? 0);
            position.needsUpdate = true;
            line.geometry.setDrawRange(0, n);
        });
    }
}

// Camera, light and the drawing of pictures. World axes as the simulator's: z is up.

import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { GPU } from "../page/gpu";

/** Where the base begins (m). */
const HOME = new THREE.Vector3(0, 0, 4);

export interface Look {
    ground: string;
    line: string;
    ink: string;
}

export class Stage {
    readonly scene = new THREE.Scene();
    readonly camera = new THREE.PerspectiveCamera(38, 1, 0.05, 100);
    readonly renderer: THREE.WebGLRenderer;
    readonly orbit: OrbitControls;
    /** What the camera goes along with. */
    follow: (() => THREE.Vector3) | undefined;
    private readonly lines: THREE.LineSegments;
    private readonly sky: THREE.HemisphereLight;
    private readonly followed = new THREE.Vector3();
    private following = false;

    constructor(readonly element: HTMLElement) {
        // Smooth edges cost a processor that draws by itself a third of its pictures a second.
        this.renderer = new THREE.WebGLRenderer({ antialias: GPU, powerPreference: "high-performance" });
        this.renderer.setPixelRatio(GPU ? Math.min(window.devicePixelRatio, 2) : 1);
        element.append(this.renderer.domElement);
        this.renderer.domElement.tabIndex = 0;
        this.renderer.domElement.setAttribute("aria-label", "The robot; drag to turn the view");

        this.camera.up.set(0, 0, 1);
        this.orbit = new OrbitControls(this.camera, this.renderer.domElement);
        this.orbit.enableDamping = true;
        this.orbit.dampingFactor = 0.12;
        this.orbit.minDistance = 0.6;
        this.orbit.maxDistance = 25;
        this.home();

        this.sky = new THREE.HemisphereLight("#ffffff", "#8b95a5", 1.6);
        this.sky.position.set(0, 0, 1);
        this.scene.add(this.sky);
        const sun = new THREE.DirectionalLight("#fff6e8", 2.2);
        sun.position.set(4, -5, 9);
        const fill = new THREE.DirectionalLight("#dfeaff", 0.5);
        fill.position.set(-5, 4, -2);
        this.scene.add(sun, fill);

        this.lines = floor();
        this.scene.add(this.lines);
        new ResizeObserver(() => this.resize()).observe(element);
        this.resize();
    }

    /** The view at the beginning. */
    home(): void {
        this.orbit.target.copy(HOME);
        this.camera.position.set(3.6, -3.9, 5.9);
        // What is narrow shows the same width from farther away.
        const narrow = Math.max(1, 0.95 / Math.max(this.camera.aspect, 0.3));
        this.camera.position.sub(HOME).multiplyScalar(narrow).add(HOME);
        this.orbit.update();
    }

    look({ ground, line }: Look): void {
        this.scene.background = new THREE.Color(ground);
        (this.lines.material as THREE.LineBasicMaterial).color.set(line);
    }

    draw(): void {
        if (this.follow === undefined) {
            this.following = false;
        } else {
            const at = this.follow();
            if (this.following) {
                const moved = at.clone().sub(this.followed);
                this.camera.position.add(moved);
                this.orbit.target.add(moved);
            } else {
                this.orbit.target.copy(at);
            }
            this.following = true;
            this.followed.copy(at);
        }
        this.orbit.update();
        this.renderer.render(this.scene, this.camera);
    }

    private resize(): void {
        const { clientWidth: width, clientHeight: height } = this.element;
        if (width === 0 || height === 0) return;
        const before = this.camera.aspect;
        this.camera.aspect = width / height;
        this.camera.updateProjectionMatrix();
        this.renderer.setSize(width, height);
        if (before === 1) this.home();
        this.draw();
    }
}

/** A grid below the robot, by which the eye sees how it drifts. */
function floor(): THREE.LineSegments {
    const [half, z] = [4, 2];
    const points: number[] = [];
    for (let i = -half; i <= half; i++) points.push(i, -half, z, i, half, z, -half, i, z, half, i, z);
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.Float32BufferAttribute(points, 3));
    return new THREE.LineSegments(geometry, new THREE.LineBasicMaterial({ transparent: true, opacity: 0.55 }));
}

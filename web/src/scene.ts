import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import type { Crawl } from "./crawl";
import { RobotView } from "./robot-view";
import { makeGround, makeRuler, themes } from "./scenery";

export type Camera = "track" | "side" | "top";

const directions: Record<Camera, [number, number, number]> = {
  track: [0.35, -1.5, 0.85],
  side: [0, -1.75, 0.3],
  top: [0, -0.001, 2],
};
const maxPathPoints = 4000;

/** The robot, its path, the ground and a ruler, drawn with three.js. */
export class Scene {
  private readonly renderer: THREE.WebGLRenderer;
  private readonly scene = new THREE.Scene();
  private readonly camera = new THREE.PerspectiveCamera(34, 1, 0.005, 12);
  private readonly controls: OrbitControls;
  private readonly light = new THREE.DirectionalLight(0xffffff, 1.6);
  private readonly path: THREE.Line;
  private scenery: THREE.Object3D[] = [];
  private robot: RobotView | null = null;
  private zeroX = 0;
  private points = 0;
  private isStale = true; // whether the picture must be drawn again

  constructor(canvas: HTMLCanvasElement) {
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.shadowMap.enabled = true;
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, canvas);
    Object.assign(this.controls, { minDistance: 0.06, maxDistance: 1.5, maxPolarAngle: 1.54, enablePan: false, keyRotateSpeed: 20 });
    this.controls.listenToKeyEvents(canvas); // arrow keys with Shift
    this.controls.addEventListener("change", () => (this.isStale = true));
    this.light.castShadow = true;
    this.light.shadow.mapSize.setScalar(1024);
    Object.assign(this.light.shadow.camera, { left: -0.15, right: 0.15, top: 0.15, bottom: -0.15, near: 0.1, far: 1.5 });
    this.light.shadow.bias = -0.0005;
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(3 * maxPathPoints), 3));
    this.path = new THREE.Line(geometry, new THREE.LineBasicMaterial({ color: "#d9480f" }));
    this.path.frustumCulled = false;
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0x8a9a90, 2), this.light, this.light.target, this.path);
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.resize();
    const dark = matchMedia("(prefers-color-scheme: dark)");
    dark.addEventListener("change", () => this.setTheme(dark.matches));
    this.setTheme(dark.matches);
  }

  /** Show another robot, at its start. */
  setRobot(crawl: Crawl): void {
    this.robot?.dispose();
    this.robot = new RobotView(crawl);
    this.scene.add(this.robot.group);
    this.zeroX = crawl.centreM()[0];
    this.points = 0;
    this.placeScenery();
    this.extendPath(crawl);
    this.update(crawl);
  }

  /** Choose a camera, which follows the robot. */
  setCamera(camera: Camera, lengthM: number): void {
    const aspect = Math.max(1, 1.15 / this.camera.aspect); // a narrow picture needs more distance
    const offset = new THREE.Vector3(...directions[camera]).multiplyScalar(1.18 * lengthM * aspect);
    this.camera.position.copy(this.controls.target).add(offset);
    this.controls.update();
  }

  /** Take positions, temperatures and loads from the simulation. */
  update(crawl: Crawl): void {
    this.robot?.update(crawl);
    this.isStale = true;
    const [x, y] = crawl.centreM();
    const target = new THREE.Vector3(x, y, 0.015);
    this.camera.position.add(target).sub(this.controls.target);
    this.controls.target.copy(target);
    this.light.position.set(x - 0.15, y - 0.25, 0.6);
    this.light.target.position.copy(target);
  }

  /** Continue the path to the robot. */
  extendPath(crawl: Crawl): void {
    if (this.points === maxPathPoints) return;
    const positions = this.path.geometry.getAttribute("position") as THREE.BufferAttribute;
    const [x, y] = crawl.centreM();
    positions.setXYZ(this.points++, x, y, 0.0006);
    positions.needsUpdate = true;
    this.path.geometry.setDrawRange(0, this.points);
  }

  /** Draw if anything has changed. */
  draw(): void {
    this.controls.update();
    if (!this.isStale) return;
    this.isStale = false;
    this.renderer.render(this.scene, this.camera);
  }

  private resize(): void {
    const { clientWidth: width, clientHeight: height } = this.renderer.domElement;
    if (!width || !height) return;
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.renderer.setSize(width, height, false);
    this.isStale = true;
  }

  private setTheme(isDark: boolean): void {
    const theme = themes[isDark ? "dark" : "light"];
    this.scene.background = new THREE.Color(theme.sky);
    this.scene.fog = new THREE.Fog(theme.sky, 0.7, 2.2);
    this.scene.remove(...this.scenery);
    this.scenery = [makeGround(theme), makeRuler(theme)];
    this.scene.add(...this.scenery);
    this.isStale = true;
    this.placeScenery();
  }

  private placeScenery(): void {
    this.scenery[1].position.set(this.zeroX, -0.045, 0);
  }
}

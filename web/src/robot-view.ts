import * as THREE from "three";
import type { Crawl } from "./crawl";
import data from "./data.json";

const cold = new THREE.Color("#333a38");
const lit = new THREE.Color("#ff8c0d");
const wireM = 0.00035; // drawn thicker than it is
const coilM = 0.0011;
const turns = 16;

/** Return a coil along z with the length 1. */
function makeCoil(): THREE.TubeGeometry {
  class Helix extends THREE.Curve<THREE.Vector3> {
    constructor() {
      super();
    }

    override getPoint(share: number, target = new THREE.Vector3()): THREE.Vector3 {
      const angle = 2 * Math.PI * turns * share;
      return target.set(coilM * Math.cos(angle), coilM * Math.sin(angle), share);
    }
  }
  return new THREE.TubeGeometry(new Helix(), turns * 10, wireM, 5);
}

/** Return the colour of a spring at a temperature. */
function toColour(temperatureC: number, target: THREE.Color): THREE.Color {
  const { ambient_c: low, cut_off_c: high } = data.spring;
  const last = data.colours.length - 1;
  const at = Math.min(Math.max(((temperatureC - low) / (high - low)) * last, 0), last);
  const [before, after] = [Math.floor(at), Math.ceil(at)].map((i) => data.colours[i]);
  const mixed = before.map((value, i) => value + (after[i] - value) * (at % 1));
  return target.setRGB(mixed[0], mixed[1], mixed[2], THREE.SRGBColorSpace);
}

/** The meshes of a robot: skin, legs, feet and springs. */
export class RobotView {
  readonly group = new THREE.Group();
  private readonly elements: THREE.Group[] = [];
  private readonly feet = new Map<number, THREE.MeshStandardMaterial>();
  private readonly springs: THREE.Mesh<THREE.TubeGeometry, THREE.MeshStandardMaterial>[];
  private readonly ends: [number, number][]; // sites of each spring
  private readonly weightN: number;

  constructor(crawl: Crawl) {
    const { model } = crawl;
    this.weightN = model.body_subtreemass[1] * 9.81;
    for (let body = 1; body < model.nbody; body++) this.elements.push(new THREE.Group());
    for (let geom = 0; geom < model.ngeom; geom++) {
      const body = model.geom_bodyid[geom];
      if (body > 0) this.elements[body - 1].add(...this.makePart(crawl, geom));
    }
    this.ends = Array.from({ length: model.ntendon }, (_, i) => {
      const first = model.tendon_adr[i];
      return [model.wrap_objid[first], model.wrap_objid[first + 1]];
    });
    const coil = makeCoil();
    this.springs = this.ends.map(() => {
      const spring = new THREE.Mesh(coil, new THREE.MeshStandardMaterial({ roughness: 0.5 }));
      spring.castShadow = true;
      return spring;
    });
    this.group.add(...this.elements, ...this.springs);
  }

  /** Return the meshes of a geom: the skin, or a foot with its leg. */
  private makePart({ model }: Crawl, geom: number): THREE.Mesh[] {
    const [a, b, c] = model.geom_size.subarray(3 * geom, 3 * geom + 3);
    const sphere = new THREE.SphereGeometry(1, 40, 24);
    if (b > 0) {
      const [r, g, blue] = model.geom_rgba.subarray(4 * geom, 4 * geom + 3);
      const colour = new THREE.Color().setRGB(r, g, blue, THREE.SRGBColorSpace);
      const material = new THREE.MeshStandardMaterial({
        color: colour, transparent: true, opacity: 0.42, roughness: 0.35, depthWrite: false,
      });
      const skin = new THREE.Mesh(sphere, material);
      skin.scale.set(a, b, c);
      skin.castShadow = true;
      return [skin];
    }
    const material = new THREE.MeshStandardMaterial({ color: cold, roughness: 0.6 });
    this.feet.set(geom, material);
    const foot = new THREE.Mesh(sphere, material);
    foot.scale.setScalar(a);
    foot.position.fromArray(model.geom_pos, 3 * geom);
    const hip = new THREE.Vector3(0, 0.6 * foot.position.y, 0);
    const along = foot.position.clone().sub(hip);
    const leg = new THREE.Mesh(
      new THREE.CylinderGeometry(0.0012, 0.0012, along.length()),
      new THREE.MeshStandardMaterial({ color: "#5a665e" }),
    );
    leg.position.copy(hip).addScaledVector(along, 0.5);
    leg.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), along.normalize());
    for (const mesh of [foot, leg]) mesh.castShadow = true;
    return [foot, leg];
  }

  /** Take positions, temperatures and loads from the simulation. */
  update(crawl: Crawl): void {
    const { xpos, xquat, site_xpos: site } = crawl.data;
    this.elements.forEach((element, i) => {
      const [w, x, y, z] = xquat.subarray(4 * (i + 1), 4 * (i + 2));
      element.position.fromArray(xpos, 3 * (i + 1));
      element.quaternion.set(x, y, z, w);
    });
    const [from, to, along] = [new THREE.Vector3(), new THREE.Vector3(), new THREE.Vector3(0, 0, 1)];
    this.springs.forEach((spring, i) => {
      from.fromArray(site, 3 * this.ends[i][0]);
      to.fromArray(site, 3 * this.ends[i][1]).sub(from);
      spring.position.copy(from);
      spring.scale.set(1, 1, to.length());
      spring.quaternion.setFromUnitVectors(along, to.normalize());
      toColour(crawl.springs.temperatureC(i), spring.material.color);
      spring.material.emissive.copy(spring.material.color).multiplyScalar(0.25);
    });
    const loads = crawl.contactLoadsN();
    const share = this.weightN / this.feet.size;
    this.feet.forEach((material, geom) => {
      const load = Math.min((loads.get(geom) ?? 0) / share, 1);
      material.color.lerpColors(cold, lit, load > 0.02 ? 0.35 + 0.65 * load : 0);
      material.emissive.copy(lit).multiplyScalar(0.6 * load);
    });
  }

  dispose(): void {
    this.group.removeFromParent();
    this.group.traverse((object) => {
      if (object instanceof THREE.Mesh) {
        object.geometry.dispose();
        object.material.dispose();
      }
    });
  }
}

// Draws a scene from a file of three.js, as its own loader reads it. `engines.py` says what a job holds.

import * as THREE from "three";
import { floatTarget, probe, savePicture, TYPES } from "./three.mjs";

export const version = THREE.REVISION;

const SIDES = ["front", "back", "double"];

export async function draw(job, save) {
  const { width, height } = job;
  const renderer = new THREE.WebGLRenderer({ canvas: document.createElement("canvas"), antialias: false });
  renderer.setPixelRatio(1);
  renderer.setSize(16, 16, false);
  renderer.setClearColor(0, 0);
  renderer.shadowMap.enabled = true;
  renderer.shadowMap.type = TYPES[job.shadowType];
  const scene = new THREE.ObjectLoader().parse(job.scene);
  let camera = null;
  let count = 0;
  scene.traverse((object) => {
    if (object.isCamera) camera ??= object;
    if (!object.isMesh) return;
    // Each material of a mesh keeps its sides, and counts as a mesh.
    const probes = [object.material].flat().map((own) => probe({
      side: SIDES[own.side], shadowSide: own.shadowSide === null ? null : SIDES[own.shadowSide],
    }, count++));
    object.material = Array.isArray(object.material) ? probes : probes[0];
  });
  const target = floatTarget(width, height, 3);
  renderer.setRenderTarget(target);
  renderer.render(scene, camera);
  await savePicture(renderer, target, job, save);
  renderer.dispose();
  renderer.forceContextLoss();
  return {};
}

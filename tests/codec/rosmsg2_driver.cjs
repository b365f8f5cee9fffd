// SPDX-License-Identifier: Apache-2.0

// Encodes messages by @foxglove/rosmsg2-serialization, from lists of their values and our .msg texts, and compares the
// bytes with ours; then it decodes ours, and compares the values. independent.py runs it:
//
//     rosmsg2_driver.cjs DIRECTORY COUNT

"use strict";

const fs = require("node:fs");
const path = require("node:path");
const { pathToFileURL } = require("node:url");
const { MessageReader, MessageWriter } = require("@foxglove/rosmsg2-serialization");

/// A number whose bits are those of an integer.
function real(bits, size) {
  const view = new DataView(new ArrayBuffer(8));
  view.setBigUint64(0, bits, true);
  return size === 4 ? view.getFloat32(0, true) : view.getFloat64(0, true);
}

class Values {
  constructor(lines) {
    this.lines = lines;
    this.next = 0;
  }
  number() {
    return BigInt(this.lines[this.next++]);
  }
  text() {
    const bytes = Array.from({ length: Number(this.number()) }, () => Number(this.number()));
    return String.fromCharCode(...bytes);
  }
  /// One value of a field's type.
  one(field, types) {
    if (field.isComplex) return this.message(types.get(field.type), types);
    switch (field.type) {
      case "string":
        return this.text();
      case "bool":
        return this.number() !== 0n;
      case "float32":
        return real(this.number(), 4);
      case "float64":
        return real(this.number(), 8);
      case "int64":
      case "uint64":
        return this.number();
      default:
        return Number(this.number());
    }
  }
  field(field, types) {
    if (!field.isArray) return this.one(field, types);
    const length = field.arrayLength ?? Number(this.number());
    return Array.from({ length }, () => this.one(field, types));
  }
  message(type, types) {
    return Object.fromEntries(type.definitions.map((f) => [f.name, this.field(f, types)]));
  }
}

/// Without the types that arrays of numbers have.
function plain(value) {
  if (ArrayBuffer.isView(value)) return Array.from(value, plain);
  if (Array.isArray(value)) return value.map(plain);
  if (typeof value === "bigint") return `${value}`;
  if (typeof value !== "object") return value;
  return Object.fromEntries(Object.entries(value).map(([k, v]) => [k, plain(v)]));
}

function compare(parse, folder, number) {
  const file = (end, form) => fs.readFileSync(path.join(folder, `${number}.${end}`), form);
  const definitions = parse(file("msg", "utf8"), { ros2: true });
  const types = new Map(definitions.map((d) => [d.name, d]));
  const root = definitions.find((d) => d.name === undefined) ?? definitions[0];
  const message = new Values(file("values", "utf8").split("\n")).message(root, types);
  const ours = file("cdr");
  const theirs = Buffer.from(new MessageWriter(definitions).writeMessage(message));
  if (!ours.equals(theirs)) {
    console.log(`type ${number}: ${ours.toString("hex")} is ours, ${theirs.toString("hex")} theirs`);
    return false;
  }
  const read = new MessageReader(definitions).readMessage(ours);
  if (JSON.stringify(plain(read)) === JSON.stringify(plain(message))) return true;
  console.log(`type ${number}: other values are read`);
  return false;
}

async function main() {
  const [folder, count] = process.argv.slice(2);
  const at = require.resolve("@foxglove/rosmsg");
  const { parse } = await import(pathToFileURL(at));
  let good = true;
  for (let i = 0; i < Number(count); ++i) good = compare(parse, folder, i) && good;
  process.exitCode = good ? 0 : 1;
}

main();

// SPDX-License-Identifier: Apache-2.0

// Compares the fields that the gateway knows of messages of ROS 2 with those that @foxglove/rosmsg-msgs-common has.
// Of a message whose fields are not the same from Humble to Jazzy the gateway must know none.
//
//     ros_schema_judge.mjs PROGRAM MODULES      PROGRAM is gateway_ros_schema

import { execFileSync } from 'node:child_process';
import { createRequire } from 'node:module';

const [program, modules] = process.argv.slice(2);
const load = createRequire(`${modules}/`);
const { parse } = load('@foxglove/rosmsg');
const { ros2humble, ros2iron, ros2jazzy } = load('@foxglove/rosmsg-msgs-common');

const PACKAGES = ['builtin_interfaces', 'geometry_msgs', 'nav_msgs', 'sensor_msgs', 'std_msgs', 'tf2_msgs'];
const TIMES = { time: 'builtin_interfaces/Time', duration: 'builtin_interfaces/Duration' };

/** The fields of a definition as text. */
const fields = ({ definitions }) =>
  definitions
    .filter((field) => !field.isConstant && field.name !== 'structure_needs_at_least_one_member')
    .map(({ type, name, isArray, arrayLength }) => `${TIMES[type] ?? type}${isArray ? `[${arrayLength ?? ''}]` : ''} ${name}`)
    .join('\n');

const versions = [ros2humble, ros2iron, ros2jazzy];
const names = [...new Set(versions.flatMap(Object.keys))].filter((name) => PACKAGES.includes(name.split('/')[0]));
const full = (name) => name.replace('/', '/msg/');
const told = execFileSync(program, names.map(full), { encoding: 'utf8' });
const ours = new Map(
  told
    .split(/^@ /m)
    .slice(1)
    .map((text) => [text.slice(0, text.indexOf('\n')), text.slice(text.indexOf('\n') + 1)]),
);

let wrong = 0;
const complain = (name, what) => {
  console.log(`${name}: ${what}`);
  ++wrong;
};
for (const name of names) {
  const theirs = new Set(versions.filter((version) => name in version).map((version) => fields(version[name])));
  const text = ours.get(full(name));
  if (theirs.size > 1) {
    if (text !== '') complain(name, 'its fields depend on the version, and the gateway has some');
  } else if (text === '') {
    complain(name, 'the gateway does not know it');
  } else {
    const [root, ...others] = parse(text, { ros2: true });
    if (fields(root) !== [...theirs][0]) complain(name, `${fields(root)}\nis ours, and\n${[...theirs][0]}\ntheirs`);
    for (const other of others) {
      const known = versions.find((version) => other.name in version)?.[other.name];
      if (!known || fields(other) !== fields(known)) complain(name, `${other.name} in it is another one`);
    }
  }
}
console.log(`${names.length} types: ${wrong === 0 ? 'ok' : `${wrong} are wrong`}`);
process.exitCode = wrong === 0 ? 0 : 1;

// SPDX-License-Identifier: Apache-2.0
// A node of ROS 2 without ROS 2: by @foxglove/ros2, which speaks ROS 2's protocol and is none of LOT's, nor of DDS's.
//
//     scripts/setup test                                installs the packages of npm into build/judges
//     node examples/ros2_node.mjs ADDRESS [SECONDS]     lists the nodes that it sees, with their topics
//
// ADDRESS is that of the network interface. Where ROS 2 is installed, `ros2 node list` and `ros2 node info` say the same.
//
// In a project of your own: copy this file, and install the packages beside it.
//     npm install @foxglove/ros2 @foxglove/rtps @foxglove/rosmsg @foxglove/rosmsg2-serialization tslib avl@1.5.3

import { createRequire } from 'node:module';
import { setTimeout as sleep } from 'node:timers/promises';
import { pathToFileURL } from 'node:url';

/** A package beside this file, or one that scripts/setup has installed. */
export const load = (name) => {
  try {
    return createRequire(import.meta.url)(name);
  } catch (error) {
    if (error.code !== 'MODULE_NOT_FOUND') throw error;
    return createRequire(new URL('../build/judges/', import.meta.url))(name);
  }
};
const { RosNode, ddsToRosTopic, ddsToRosType } = load('@foxglove/ros2');
const { UdpSocketNode } = load('@foxglove/ros2/nodejs');
const { Durability, HistoryKind, ParametersView, Reliability } = load('@foxglove/rtps');
const { parse } = load('@foxglove/rosmsg');
const { MessageReader } = load('@foxglove/rosmsg2-serialization');

// A writer that says nothing of its reliability is reliable, by DDS. @foxglove/rtps takes no notice of such a one.
const { reliability } = ParametersView.prototype;
const RELIABLE = { kind: Reliability.Reliable, maxBlockingTime: { sec: 0, nsec: 1e8 } };
ParametersView.prototype.reliability = function () {
  return reliability.call(this) ?? RELIABLE;
};

/** What each process of ROS 2 says of its nodes; the size of an identity is that of Humble. */
const GRAPH = `rmw_dds_common/Gid gid
rmw_dds_common/NodeEntitiesInfo[] node_entities_info_seq
================================================================================
MSG: rmw_dds_common/Gid
uint8[24] data
================================================================================
MSG: rmw_dds_common/NodeEntitiesInfo
string node_namespace
string node_name
rmw_dds_common/Gid[] reader_gid_seq
rmw_dds_common/Gid[] writer_gid_seq`;

/** A node on one network interface. */
export const begin = async (name, address) => {
  const node = new RosNode({
    name,
    addresses: [address],
    udpSocketCreate: async (options) => {
      const socket = await UdpSocketNode.Create(options);
      const join = socket.addMembership.bind(socket);
      socket.addMembership = async (group) => {
        await socket.setMulticastInterface(address);
        await join(group, address);
      };
      return socket;
    },
  });
  await node.start();
  return node;
};

const hex = (bytes) => Buffer.from(bytes).toString('hex');

/** Keeps what the others say of their nodes: the function returns it as lines. */
const watch = (node) => {
  const reader = new MessageReader(parse(GRAPH, { ros2: true }));
  const endpoints = new Map();
  const graphs = new Map();
  const note = ({ guidPrefix, entityId, topicName, typeName }) =>
    endpoints.set(guidPrefix + entityId.toString(16).padStart(8, '0'), [ddsToRosTopic(topicName)?.topic, ddsToRosType(typeName)]);
  node.on('discoveredPublication', note);
  node.on('discoveredSubscription', note);
  // @foxglove/ros2 has no name for this topic, which is no topic of a user's: its participant takes the name of DDS.
  const participant = node._participant;
  participant.on('userData', ({ subscription, publication, serializedData }) => {
    if (subscription.topicName !== 'ros_discovery_info') return;
    graphs.set(publication.guidPrefix, reader.readMessage(serializedData));
  });
  participant.subscribe({
    topicName: 'ros_discovery_info',
    typeName: 'rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_',
    durability: Durability.TransientLocal,
    reliability: RELIABLE,
    history: { kind: HistoryKind.KeepLast, depth: 1 },
  });
  const rows = (gids, verb) =>
    gids
      .map(({ data }) => endpoints.get(hex(data.slice(0, 16))))
      .filter((endpoint) => endpoint?.[0])
      .map(([topic, type]) => `    ${verb} ${topic}: ${type}`)
      .sort();
  return () =>
    [...graphs.values()]
      .flatMap((graph) => graph.node_entities_info_seq)
      .map((one) =>
        [
          `${one.node_namespace.replace(/\/$/, '')}/${one.node_name}`,
          ...rows(one.writer_gid_seq, 'publishes'),
          ...rows(one.reader_gid_seq, 'subscribes to'),
        ].join('\n'),
      )
      .sort();
};

const main = async () => {
  const [address, seconds = '3'] = process.argv.slice(2);
  if (!address) {
    console.error('usage: node ros2_node.mjs ADDRESS [SECONDS]');
    process.exit(2);
  }
  const node = await begin('ros2_node', address);
  const told = watch(node);
  await sleep(1000 * Number(seconds));
  console.log(told().join('\n'));
  await node.shutdown();
};

if (import.meta.url === pathToFileURL(process.argv[1]).href) await main();

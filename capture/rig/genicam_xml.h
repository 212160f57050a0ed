// The GenICam description that the simulated cameras serve, and the registers it names.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "capture/device/wire_format.h"

namespace lightsketch::gige {

// GigE Vision bootstrap registers (GigE Vision 1.2, section 27), as far as they are served.
inline constexpr std::uint32_t kVersion = 0x0000;
inline constexpr std::uint32_t kDeviceMode = 0x0004;
inline constexpr std::uint32_t kMacHigh = 0x0008;
inline constexpr std::uint32_t kMacLow = 0x000c;
inline constexpr std::uint32_t kSupportedIpConfiguration = 0x0010;
inline constexpr std::uint32_t kCurrentIpConfiguration = 0x0014;
inline constexpr std::uint32_t kCurrentIp = 0x0024;
inline constexpr std::uint32_t kSubnetMask = 0x0034;
inline constexpr std::uint32_t kManufacturer = 0x0048;      // 32 bytes
inline constexpr std::uint32_t kModel = 0x0068;             // 32
inline constexpr std::uint32_t kDeviceVersion = 0x0088;     // 32
inline constexpr std::uint32_t kManufacturerInfo = 0x00a8;  // 48
inline constexpr std::uint32_t kSerial = 0x00d8;            // 16
inline constexpr std::uint32_t kUserName = 0x00e8;          // 16
inline constexpr std::uint32_t kDiscoverySize =
    0x00f8;                                       // a discovery answer is the registers up to here
inline constexpr std::uint32_t kXmlUrl = 0x0200;  // 512
inline constexpr std::uint32_t kNetworkInterfaceCount = 0x0600;
inline constexpr std::uint32_t kStreamChannelCount = 0x0904;
inline constexpr std::uint32_t kCapability = 0x0934;
inline constexpr std::uint32_t kHeartbeatTimeout = 0x0938;  // milliseconds
inline constexpr std::uint32_t kTickFrequencyHigh = 0x093c;
inline constexpr std::uint32_t kTickFrequencyLow = 0x0940;
inline constexpr std::uint32_t kTimestampControl = 0x0944;  // 2: latch
inline constexpr std::uint32_t kTimestampHigh = 0x0948;
inline constexpr std::uint32_t kTimestampLow = 0x094c;
inline constexpr std::uint32_t kControlPrivilege = 0x0a00;
inline constexpr std::uint32_t kStreamPort = 0x0d00;
inline constexpr std::uint32_t kStreamPacketSize = 0x0d04;  // bit 31: fire a test packet
inline constexpr std::uint32_t kStreamPacketDelay = 0x0d08;
inline constexpr std::uint32_t kStreamAddress = 0x0d18;
inline constexpr std::uint32_t kStreamSourcePort = 0x0d1c;

// Registers of our own.
inline constexpr std::uint32_t kWidth = 0x1000;
inline constexpr std::uint32_t kHeight = 0x1004;
inline constexpr std::uint32_t kOffsetX = 0x1008;
inline constexpr std::uint32_t kOffsetY = 0x100c;
inline constexpr std::uint32_t kPixelFormat = 0x1010;
inline constexpr std::uint32_t kSensorWidth = 0x1014;
inline constexpr std::uint32_t kSensorHeight = 0x1018;
inline constexpr std::uint32_t kAcquisitionMode = 0x101c;
inline constexpr std::uint32_t kAcquisition = 0x1020;  // 1: running
inline constexpr std::uint32_t kPayloadSize = 0x1024;
inline constexpr std::uint32_t kExposureTime =
    0x1040;                                          // float64, microseconds; so are the following
inline constexpr std::uint32_t kGain = 0x1048;       // dB
inline constexpr std::uint32_t kFrameRate = 0x1050;  // Hz
inline constexpr std::uint32_t kGuideMode = 0x1058;  // 0, 1, 2
inline constexpr std::uint32_t kGuideX = 0x1060;
inline constexpr std::uint32_t kGuideY = 0x1068;
inline constexpr std::uint32_t kGuideZ = 0x1070;
inline constexpr std::uint32_t kRigProgram = 0x1078;     // 0 to 5, see rig_program.h
inline constexpr std::uint32_t kTriggerMode = 0x1080;    // integers from here on; 1: on
inline constexpr std::uint32_t kTriggerSource = 0x1084;  // 0: Software, 1: Line1
inline constexpr std::uint32_t kTriggerSoftware = 0x1088;
inline constexpr std::uint32_t kPtpEnable = 0x108c;
inline constexpr std::uint32_t kPtpStatus = 0x1090;  // 0: disabled, 1: listening, 2: slave
inline constexpr std::uint32_t kChunkMode = 0x1094;
inline constexpr std::uint32_t kChunkSelector = 0x1098;
inline constexpr std::uint32_t kChunkEnable = 0x10a0;  // one for each of the chunks below
inline constexpr std::uint32_t kChunkCount = 4;
inline constexpr std::uint32_t kRegistersEnd = kChunkEnable + 4 * kChunkCount;
inline constexpr std::uint32_t kXml = 0x10000;

// Chunks after the picture (GigE Vision 2.0, section 27), in the order of their enabling registers.
inline constexpr std::uint32_t kImageChunk = 1;
inline constexpr std::uint32_t kExposureChunk = 0x1001;   // float64, microseconds
inline constexpr std::uint32_t kGainChunk = 0x1002;       // float64, dB
inline constexpr std::uint32_t kTimestampChunk = 0x1003;  // 64 bits
inline constexpr std::uint32_t kCrcChunk = 0x1004;        // 32 bits, of all bytes before its value

// Limits; writes beyond them are refused.
inline constexpr std::uint32_t kMinSide = 8;
inline constexpr std::uint32_t kSideStep = 2;  // keeps the phase of a Bayer pattern
inline constexpr double kMinExposureUs = 10, kMaxExposureUs = 10e6;
inline constexpr double kMaxGainDb = 48;
inline constexpr double kMinFrameRate = 0.1, kMaxFrameRate = 1000;
inline constexpr std::uint32_t kMinPacketSize = 220, kMaxPacketSize = 9000;

struct Features {
  std::vector<WireFormat> formats;
  bool chunks = false;
  bool ptp = false;
};

// Padded with spaces to whole 32-bit words, so that every GVCP read of it is aligned.
std::string genicamXml(const Features& features);

}  // namespace lightsketch::gige

#include "capture/rig/genicam_xml.h"

#include <fmt/format.h>

#include "capture/rig/rig_program.h"

namespace lightsketch::gige {
namespace {

std::string intRegister(std::string_view name, std::uint32_t address, std::string_view access,
                        std::string_view index = "") {
  return fmt::format(
      "<IntReg Name=\"{}\"><Address>{:#x}</Address>{}<Length>4</Length>"
      "<AccessMode>{}</AccessMode><pPort>Device</pPort><Cachable>NoCache</Cachable><Sign>Unsigned</"
      "Sign>"
      "<Endianess>BigEndian</Endianess></IntReg>\n",
      name, address, index, access);
}

std::string boolean(std::string_view name, std::uint32_t address, std::string_view index = "") {
  return fmt::format(
             "<Boolean Name=\"{0}\"><pValue>{0}Reg</pValue><OnValue>1</OnValue>"
             "<OffValue>0</OffValue></Boolean>\n",
             name) +
         intRegister(fmt::format("{}Reg", name), address, "RW", index);
}

// Values count from 0. Without an address it is always the first.
std::string enumeration(std::string_view name, std::initializer_list<std::string_view> entries,
                        std::uint32_t address) {
  std::string xml = fmt::format("<Enumeration Name=\"{}\">", name);
  int value = 0;
  for (const std::string_view entry : entries) {
    xml += fmt::format("<EnumEntry Name=\"{}\"><Value>{}</Value></EnumEntry>", entry, value++);
  }
  if (address == 0) return xml + "<Value>0</Value></Enumeration>\n";
  xml += fmt::format("<pValue>{}Reg</pValue></Enumeration>\n", name);
  return xml + intRegister(fmt::format("{}Reg", name), address, "RW");
}

std::string chunk(std::string_view kind, std::string_view name, std::uint32_t id, int length) {
  const bool real = kind == "Float";
  return fmt::format(
      "<{0} Name=\"{1}\"><pValue>{1}Reg</pValue></{0}>\n"
      "<{2} Name=\"{1}Reg\"><Address>0</Address><Length>{3}</Length><AccessMode>RO</AccessMode>"
      "<pPort>{1}Port</pPort><Cachable>NoCache</Cachable>{4}<Endianess>BigEndian</Endianess></"
      "{2}>\n"
      "<Port Name=\"{1}Port\"><ChunkID>{5:x}</ChunkID></Port>\n",
      kind, name, real ? "FloatReg" : "IntReg", length, real ? "" : "<Sign>Unsigned</Sign>", id);
}

std::string integer(std::string_view name, std::uint32_t address) {
  return fmt::format("<Integer Name=\"{0}\"><pValue>{0}Reg</pValue></Integer>\n", name) +
         intRegister(fmt::format("{}Reg", name), address, "RO");
}

// May not exceed the size `sensor` less the feature `other`.
std::string side(std::string_view name, std::uint32_t address, std::uint32_t min,
                 std::string_view sensor, std::string_view other) {
  return fmt::format(
             "<Integer Name=\"{0}\"><pIsLocked>TLParamsLocked</pIsLocked><pValue>{0}Reg</pValue>"
             "<Min>{1}</Min><pMax>{0}Max</pMax><Inc>{2}</Inc></Integer>\n"
             "<IntSwissKnife Name=\"{0}Max\"><pVariable Name=\"SENSOR\">{3}</pVariable>"
             "<pVariable Name=\"OTHER\">{4}</pVariable><Formula>SENSOR - OTHER</Formula>"
             "</IntSwissKnife>\n",
             name, min, kSideStep, sensor, other) +
         intRegister(fmt::format("{}Reg", name), address, "RW");
}

std::string real(std::string_view name, std::uint32_t address, double min, double max,
                 std::string_view unit) {
  return fmt::format(
      "<Float Name=\"{0}\"><pValue>{0}Reg</pValue><Min>{2}</Min><Max>{3}</Max><Unit>{4}</Unit>"
      "</Float>\n"
      "<FloatReg Name=\"{0}Reg\"><Address>{1:#x}</Address><Length>8</Length>"
      "<AccessMode>RW</AccessMode><pPort>Device</pPort><Cachable>NoCache</Cachable>"
      "<Endianess>BigEndian</Endianess></FloatReg>\n",
      name, address, min, max, unit);
}

std::string string(std::string_view name, std::uint32_t address, int length) {
  return fmt::format(
      "<StringReg Name=\"{}\"><Address>{:#x}</Address><Length>{}</Length>"
      "<AccessMode>RO</AccessMode><pPort>Device</pPort></StringReg>\n",
      name, address, length);
}

std::string command(std::string_view name, int value) {
  return fmt::format(
      "<Command Name=\"{}\"><pValue>AcquisitionReg</pValue><CommandValue>{}</CommandValue>"
      "</Command>\n",
      name, value);
}

constexpr std::string_view kHead = R"(<?xml version="1.0" encoding="utf-8"?>
<RegisterDescription ModelName="SimulatedCamera" VendorName="lightsketch" ToolTip="Simulated camera"
  StandardNameSpace="GEV" SchemaMajorVersion="1" SchemaMinorVersion="1" SchemaSubMinorVersion="0"
  MajorVersion="1" MinorVersion="0" SubMinorVersion="0"
  ProductGuid="5b0a3c1e-7c5f-4f0b-9d56-2f1f8c1a6e01"
  VersionGuid="5b0a3c1e-7c5f-4f0b-9d56-2f1f8c1a6e02"
  xmlns="http://www.genicam.org/GenApi/Version_1_1">
<Category Name="Root"><pFeature>DeviceControl</pFeature><pFeature>ImageFormatControl</pFeature>
<pFeature>AcquisitionControl</pFeature><pFeature>AnalogControl</pFeature>
<pFeature>TransportLayerControl</pFeature><pFeature>LampControl</pFeature></Category>
<Category Name="DeviceControl"><pFeature>DeviceVendorName</pFeature>
<pFeature>DeviceModelName</pFeature><pFeature>DeviceVersion</pFeature>
<pFeature>DeviceID</pFeature></Category>
<Category Name="ImageFormatControl"><pFeature>SensorWidth</pFeature>
<pFeature>SensorHeight</pFeature><pFeature>Width</pFeature><pFeature>Height</pFeature>
<pFeature>OffsetX</pFeature><pFeature>OffsetY</pFeature><pFeature>PixelFormat</pFeature></Category>
<Category Name="AcquisitionControl"><pFeature>AcquisitionMode</pFeature>
<pFeature>AcquisitionStart</pFeature><pFeature>AcquisitionStop</pFeature>
<pFeature>AcquisitionFrameRate</pFeature><pFeature>ExposureTime</pFeature>
<pFeature>TriggerSelector</pFeature><pFeature>TriggerMode</pFeature>
<pFeature>TriggerSource</pFeature><pFeature>TriggerSoftware</pFeature></Category>
<Category Name="AnalogControl"><pFeature>Gain</pFeature></Category>
<Category Name="TransportLayerControl"><pFeature>PayloadSize</pFeature>
<pFeature>GevSCPSPacketSize</pFeature></Category>
<Category Name="LampControl"><pFeature>GuideMode</pFeature><pFeature>GuideX</pFeature>
<pFeature>GuideY</pFeature><pFeature>GuideZ</pFeature>
<pFeature>RigProgram</pFeature></Category>
<Port Name="Device"></Port>
<Integer Name="TLParamsLocked"><Visibility>Invisible</Visibility><Value>0</Value><Min>0</Min>
<Max>1</Max></Integer>
)";

}  // namespace

std::string genicamXml(const Features& features) {
  std::string xml(kHead);
  xml += string("DeviceVendorName", kManufacturer, 32);
  xml += string("DeviceModelName", kModel, 32);
  xml += string("DeviceVersion", kDeviceVersion, 32);
  xml += string("DeviceID", kSerial, 16);
  xml += integer("SensorWidth", kSensorWidth);
  xml += integer("SensorHeight", kSensorHeight);
  xml += side("Width", kWidth, kMinSide, "SensorWidth", "OffsetXReg");
  xml += side("Height", kHeight, kMinSide, "SensorHeight", "OffsetYReg");
  xml += side("OffsetX", kOffsetX, 0, "SensorWidth", "WidthReg");
  xml += side("OffsetY", kOffsetY, 0, "SensorHeight", "HeightReg");

  xml += "<Enumeration Name=\"PixelFormat\"><pIsLocked>TLParamsLocked</pIsLocked>\n";
  for (const WireFormat& format : features.formats) {
    xml += fmt::format("<EnumEntry Name=\"{}\"><Value>{}</Value></EnumEntry>\n", format.name,
                       format.code);
  }
  xml += "<pValue>PixelFormatReg</pValue></Enumeration>\n";
  xml += intRegister("PixelFormatReg", kPixelFormat, "RW");

  xml +=
      "<Enumeration Name=\"AcquisitionMode\"><EnumEntry Name=\"Continuous\"><Value>0</Value>"
      "</EnumEntry><pValue>AcquisitionModeReg</pValue></Enumeration>\n";
  xml += intRegister("AcquisitionModeReg", kAcquisitionMode, "RW");
  xml += command("AcquisitionStart", 1);
  xml += command("AcquisitionStop", 0);
  xml += intRegister("AcquisitionReg", kAcquisition, "RW");
  xml += real("AcquisitionFrameRate", kFrameRate, kMinFrameRate, kMaxFrameRate, "Hz");
  xml += real("ExposureTime", kExposureTime, kMinExposureUs, kMaxExposureUs, "us");
  xml += real("Gain", kGain, 0, kMaxGainDb, "dB");
  xml += integer("PayloadSize", kPayloadSize);
  xml += fmt::format(
      "<Integer Name=\"GevSCPSPacketSize\"><pIsLocked>TLParamsLocked</pIsLocked>"
      "<pValue>GevSCPSPacketSizeReg</pValue><Min>{}</Min><Max>{}</Max><Inc>4</Inc></Integer>\n"
      "<MaskedIntReg Name=\"GevSCPSPacketSizeReg\"><Address>{:#x}</Address><Length>4</Length>"
      "<AccessMode>RW</AccessMode><pPort>Device</pPort><Cachable>NoCache</Cachable>"
      "<LSB>31</LSB><MSB>16</MSB><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess>"
      "</MaskedIntReg>\n"
      "<Command Name=\"GevSCPSFireTestPacket\"><pIsLocked>TLParamsLocked</pIsLocked>"
      "<pValue>GevSCPSFireTestPacketReg</pValue><CommandValue>1</CommandValue></Command>\n"
      "<MaskedIntReg Name=\"GevSCPSFireTestPacketReg\"><Address>{:#x}</Address><Length>4</Length>"
      "<AccessMode>RW</AccessMode><pPort>Device</pPort><Cachable>NoCache</Cachable>"
      "<Bit>0</Bit><Endianess>BigEndian</Endianess></MaskedIntReg>\n",
      kMinPacketSize, kMaxPacketSize, kStreamPacketSize, kStreamPacketSize);
  xml += real("GuideMode", kGuideMode, 0, 2, "");
  xml += real("GuideX", kGuideX, -1, 1, "");
  xml += real("GuideY", kGuideY, -1, 1, "");
  xml += real("GuideZ", kGuideZ, -1, 1, "");
  xml += enumeration("TriggerSelector", {"FrameStart"}, 0);
  xml += enumeration("TriggerMode", {"Off", "On"}, kTriggerMode);
  xml += enumeration("TriggerSource", {"Software", "Line1"}, kTriggerSource);
  xml +=
      "<Command Name=\"TriggerSoftware\"><pValue>TriggerSoftwareReg</pValue>"
      "<CommandValue>1</CommandValue></Command>\n" +
      intRegister("TriggerSoftwareReg", kTriggerSoftware, "RW");
  if (features.ptp) {
    xml += boolean("PtpEnable", kPtpEnable);
    xml += enumeration("PtpStatus", {"Disabled", "Listening", "Slave"}, kPtpStatus);
  }
  if (features.chunks) {
    xml += boolean("ChunkModeActive", kChunkMode);
    xml += enumeration("ChunkSelector", {"ExposureTime", "Gain", "Timestamp", "PayloadCRC16"},
                       kChunkSelector);
    xml += boolean("ChunkEnable", kChunkEnable, "<pIndex Offset=\"4\">ChunkSelector</pIndex>");
    xml += chunk("Float", "ChunkExposureTime", kExposureChunk, 8);
    xml += chunk("Float", "ChunkGain", kGainChunk, 8);
    xml += chunk("Integer", "ChunkTimestamp", kTimestampChunk, 8);
    xml += chunk("Integer", "ChunkPayloadCRC16", kCrcChunk, 4);
  }
  xml += real("RigProgram", kRigProgram, 0, kRigProgramCount - 1, "");
  xml += "</RegisterDescription>\n";
  xml.resize((xml.size() + 3) / 4 * 4, ' ');
  return xml;
}

}  // namespace lightsketch::gige
